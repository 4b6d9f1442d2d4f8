"""A picture is opened where there is a viewer and a display; otherwise its path is told."""

from __future__ import annotations

import stat
import time
from pathlib import Path

import pytest

from equimesh_cli import report
from equimesh_cli.report import open_picture, told


@pytest.fixture
def picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A picture; no program can be found, and there is no display."""
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "a b.png").touch()
    return tmp_path / "a b.png"


def test_without_a_display_or_a_viewer_the_path_is_told(picture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert told(picture) == f"no viewer or no display here: the picture is {picture}"
    monkeypatch.setenv("DISPLAY", ":9")
    assert not open_picture(picture)


def test_the_viewer_gets_the_file_and_is_not_waited_for(picture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-9")
    program = picture.parent / "xdg-open"
    # It ends when the test has looked: a caller that waits for it would never come so far.
    program.write_text('#!/bin/sh\necho "$1" > "$0.seen"\nwhile [ ! -e "$0.end" ]; do /bin/sleep 0.05; done\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.delenv("WAYLAND_DISPLAY")
    assert not open_picture(picture)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-9")
    assert told(picture) == f"opened {picture}"
    seen = program.with_suffix(".seen")
    limit = time.monotonic() + 30
    while not (seen.exists() and seen.read_text()) and time.monotonic() < limit:
        time.sleep(0.02)
    program.with_suffix(".end").touch()
    assert seen.read_text() == f"{picture}\n"


def test_a_program_that_cannot_run_is_no_viewer(picture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "_opener", lambda: [str(picture)])
    assert not open_picture(picture)
