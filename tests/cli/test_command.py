"""The command line: codes, words, files."""

from __future__ import annotations

import importlib.metadata
import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from equimesh_cli import main

COMMAND = [sys.executable, "-m", "equimesh_cli"]


@pytest.mark.parametrize(
    "command", ["", "demo", "serve", "worker", "config", "doctor", "keys", "database", "generate", "solve", "check"]
)
def test_help_has_examples_and_exit_codes(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([*command.split(), "--help"])
    assert caught.value.code == 0
    said = capsys.readouterr().out
    assert f"examples:\n  equimesh {command or 'demo'}" in said
    assert "130  interrupted" in said


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
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (130, b"", b"\nequimesh: interrupted\n")
    assert service.meshes["m0"]["status"] == "canceled"


def test_a_closed_pipe_is_no_error(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "-n", "5", "--json", "--url", service.url]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert (process.wait(timeout=60), err) == (0, b"")
