"""The command line: codes, words, files."""

from __future__ import annotations

import errno
import importlib.metadata
import re
import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from equimesh_cli import main
from equimesh_cli.command import sentence

# The exit codes of commands besides 0, 2 and 130.
OWN_CODES = {
    "": (1, 3, 4),
    "demo": (1, 3),
    "doctor": (1,),
    "keys": (3,),
    "database": (3,),
    "generate": (1, 3, 4),
    "solve": (1,),
    "check": (3,),
}
LARGE = ("numpy", "scipy", "numba", "fastapi", "pydantic", "sqlalchemy", "httpx", "tqdm", "matplotlib", "shtab")
COMMAND = [sys.executable, "-m", "equimesh_cli"]


@pytest.mark.parametrize(
    "command",
    ["", "demo", "serve", "worker", "config", "doctor", "keys", "database", "generate", "solve", "check", "completion"],
)
def test_help_has_examples_and_its_own_exit_codes_in_80_columns(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as caught:
        main([*command.split(), "--help"])
    assert caught.value.code == 0
    said = capsys.readouterr().out
    assert f"examples:\n  equimesh {command or 'demo'}" in said
    codes = said.split("\nexit codes:\n")[1].splitlines()
    assert all(re.fullmatch(r"  (0|1|2|3|4|130) +\S.*", line) for line in codes)
    assert [int(line.split()[0]) for line in codes] == sorted({0, 2, 130, *OWN_CODES.get(command, ())})
    assert max(map(len, said.splitlines())) <= 80


@pytest.mark.parametrize("action", ["keys revoke", "database backup"])
def test_actions_have_exit_codes_too(action: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*action.split(), "--help"])
    assert "\nexit codes:\n  0    done\n" in capsys.readouterr().out


def test_the_command_alone_prints_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    alone = capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["--help"])
    assert (alone.out, alone.err) == (capsys.readouterr().out, "")


def test_the_help_loads_no_large_package() -> None:
    code = (
        "import sys; from equimesh_cli import main; main([]);"
        f"print([name for name in {LARGE} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"equimesh {importlib.metadata.version('equimesh')}\n"


def test_an_interrupt_is_130_and_cancels(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "--label", "hang", "--url", service.url]
    # Where tests run in the background interrupts are ignored, and what they start would inherit that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    signal.signal(signal.SIGINT, before)
    limit = time.monotonic() + 30
    while not service.seen("GET", "meshes") and time.monotonic() < limit:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert (process.returncode, out, err) == (130, b"", b"\nequimesh: interrupted\n")
    assert service.meshes["m0"]["status"] == "canceled"


def test_an_interrupt_while_the_commands_are_imported_is_130() -> None:
    code = """
import signal, sys
class Interrupting:
    def find_spec(self, name, *_):
        if name == "equimesh_cli.command":
            signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupting())
from equimesh_cli import main
sys.exit(main(["--help"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"\nequimesh: interrupted\n")


@pytest.mark.parametrize("name", [None, "mesh.vtu"])
def test_a_full_disk_says_what_to_do(name: str | None) -> None:
    full = OSError(errno.ENOSPC, "No space left on device", name)
    place = f"{name}: " if name else ""
    assert sentence(full) == f"{place}No space left on device: make room, or write to another disk"


def test_a_closed_pipe_is_no_error(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "-n", "5", "--json", "--url", service.url]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert (process.wait(timeout=300), err) == (0, b"")
