"""Checks of the source itself: format, lint, types, and the directions of imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BIN = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["mypy"],
        ["lint-imports"],
    ],
    ids=" ".join,
)
def test_check_passes(command: list[str]) -> None:
    done = subprocess.run([BIN / command[0], *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_nothing_names_a_place_outside_the_project() -> None:
    """No path of one machine, no package index: whoever clones the project has only the project."""
    # Written in pieces, so that this file does not find itself.
    private = [
        "/" + "root/",
        "/" + "home/",
        "../" + "shared",
        "../" + ".library",
        "pypi" + ".org",
        "files.python" + "hosted",
    ]
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    for name in filter(None, tracked):
        if (ROOT / name).suffix in {".png", ".npz", ".ico"} or not (ROOT / name).is_file():
            continue
        text = (ROOT / name).read_text(encoding="utf-8")
        assert [place for place in private if place in text] == [], name
