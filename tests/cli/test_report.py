"""What is told of a mesh: what it is worth comes first."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from client.fake_service import CERTIFICATE
from equimesh_cli import report
from equimesh_cli.report import announce_compiling, open_picture, print_report, told
from equimesh_client import Certificate


def test_the_gain_comes_first_then_the_warnings_then_the_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    certificate = Certificate.from_json(CERTIFICATE)
    print_report(certificate, "8 x 8", "The mesh is valid.")
    first, second, third, blank, heading, *details = capsys.readouterr().out.splitlines()
    assert first == certificate.headline
    assert "5.4 times smaller than on the uniform mesh" in first
    assert second == "8 x 8 points. The mesh is valid."
    assert third == f"warning: {certificate.warnings[0]}"
    assert (blank, heading) == ("", "Details:")
    assert details == certificate.details.splitlines()
    assert not any("warning" in line for line in details)


def test_without_a_certificate_the_end_of_the_solve_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(None, 64, "The mesh is finished.")
    assert capsys.readouterr().out == "64 points: The mesh is finished.\n"


# The message about compiling.


COMMAND = [sys.executable, "-m", "equimesh_cli"]


@pytest.mark.everything  # it compiles all kernels anew
def test_solve_says_when_it_has_to_compile(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    variables = {**os.environ, "EQUIMESH_CACHE_DIR": str(tmp_path)}
    said = []
    for _ in range(2):
        command = [*COMMAND, "solve", "x*y", "-n", "9", "--monitor", "arc-length"]  # fewer kernels than auto
        done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=300, check=True)
        said.append(done.stderr)
    assert said == ["Compiling the numerical loops, once in this environment ...\n", ""]


def test_the_message_comes_once_and_not_for_loops_of_other_packages(capsys: pytest.CaptureFixture[str]) -> None:
    numba = pytest.importorskip("numba")
    from equimesh.compiling import SENTENCE
    from equimesh.numerics import compiled

    def compile_twice() -> None:
        for value in (1, 1.0):
            loop = numba.njit(lambda x: x)
            compiled._loops.append(loop)
            loop(value)
            compiled._loops.remove(loop)

    with announce_compiling():
        numba.njit(lambda x: x)(1)
    assert capsys.readouterr().err == ""
    with announce_compiling():
        compile_twice()
    assert capsys.readouterr().err == f"{SENTENCE} ...\n"
    with announce_compiling(shown=False):
        compile_twice()
    assert capsys.readouterr().err == ""


# A picture is opened where there is a viewer and a display; otherwise its path is told.


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
