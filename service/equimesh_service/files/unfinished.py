"""Temporary files: all files are written here first; those that a crash leaves are removed."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Older files were left by a crash; younger ones another service may still be writing.
_LEFT_OVER_SECONDS = 6 * 3600.0


def clear(folder: Path, *, alone: bool) -> None:
    """Make the folder, and remove leftover files: all when ``alone``, otherwise those that are hours old."""
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.iterdir():
        try:
            old = alone or time.time() - left.stat().st_mtime > _LEFT_OVER_SECONDS
        except FileNotFoundError:
            continue  # another service has just removed it
        if old and left.is_dir():  # writers of several files work in a folder of their own
            shutil.rmtree(left, ignore_errors=True)
        elif old:
            left.unlink(missing_ok=True)


@contextmanager
def temporary(folder: Path, suffix: str) -> Iterator[Path]:
    """A new empty file, removed at the end if it is still there."""
    number, name = tempfile.mkstemp(suffix=suffix, dir=folder)
    os.close(number)
    path = Path(name)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
