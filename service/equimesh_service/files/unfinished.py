"""Temporary files: everything is written here first, and what a crash leaves is cleared."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Seconds after which a file here is left over, where other services may be writing theirs.
_LEFT_OVER_SECONDS = 6 * 3600.0


def clear(folder: Path, *, alone: bool) -> None:
    """Make the folder, and remove what was left there: all of it when ``alone``, else what is hours old."""
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.iterdir():
        try:
            old = alone or time.time() - left.stat().st_mtime > _LEFT_OVER_SECONDS
        except FileNotFoundError:
            continue  # another service was done with it
        if old and left.is_dir():  # a writer of several files works in a folder of its own
            shutil.rmtree(left, ignore_errors=True)
        elif old:
            left.unlink(missing_ok=True)


@contextmanager
def temporary(folder: Path, suffix: str) -> Iterator[Path]:
    """A new empty file; whatever is left there at the end is removed."""
    number, name = tempfile.mkstemp(suffix=suffix, dir=folder)
    os.close(number)
    path = Path(name)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
