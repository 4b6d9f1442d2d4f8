"""`equimesh completion`: its script, sourced in a real bash."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from equimesh_cli import main
from equimesh_cli.command import build_parser
from equimesh_cli.commands.completion import SHELLS, script

# Completes each line as bash does after the tab key: words and their last one, which may be empty.
COMPLETE = """
source ./script
complete_line() {
    COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=()
    "$(complete -p equimesh | sed 's/.*-F \\([^ ]*\\).*/\\1/')" equimesh "${COMP_WORDS[-1]}" "${COMP_WORDS[-2]}"
    echo "${COMPREPLY[*]}"
}
"""
CASES = {
    "equimesh sol": "solve",
    "equimesh keys ''": "create list change revoke",
    "equimesh solve --mon": "--monitor",
    "equimesh solve --monitor ''": "auto least-error nodal-solution arc-length curvature weight tensor",
    "equimesh solve --samples m": "mine.csv",
    "equimesh solve 'x*y' -o m": "mine.csv",
    "equimesh solve --monitor weight --rho m": "mine.csv",
    "equimesh serve --data-dir f": "folder",
    "equimesh serve --engine ''": "processes dask",
    "equimesh serve --metrics t": "true",
    "equimesh database backup m": "mine.csv",
    "equimesh completion ''": "bash zsh tcsh",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the script for bash, a file and a folder."""
    (tmp_path / "script").write_text(script(build_parser("completion"), "bash"))
    (tmp_path / "mine.csv").touch()
    (tmp_path / "folder").mkdir()
    return tmp_path


def test_bash_completes_commands_options_words_and_files(folder: Path) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("there is no bash")
    lines = "\n".join(f"complete_line {line}" for line in CASES)
    done = subprocess.run([bash, "-c", COMPLETE + lines], cwd=folder, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert dict(zip(CASES, done.stdout.splitlines(), strict=True)) == CASES


@pytest.mark.parametrize("shell", SHELLS)
def test_there_is_a_script_for_every_shell(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    said = capsys.readouterr().out
    assert "least-error" in said
    assert "data-dir" in said  # also the settings of a service


def test_other_shells_are_refused_with_those_that_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["completion", "fish"])
    assert caught.value.code == 2
    assert "bash" in capsys.readouterr().err
