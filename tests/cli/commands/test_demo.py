"""`equimesh demo`."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import pytest

from equimesh_cli import main
from equimesh_cli.parser import Exit


def test_the_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--output", str(tmp_path / "out")]) == 0
    said, complained = capsys.readouterr()
    assert complained == ""
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"paper.vtu", "paper.vtk", "paper.xdmf", "paper.png", "paper-convergence.png", "wave.vtu"}
    assert all(path.stat().st_size > 0 for path in (tmp_path / "out").iterdir())
    for words in ("1.6375", "q_eq", "max_q_eq", "interpolation error L2", "wave.png"):
        assert words in said
    (gain,) = re.findall(r"interpolation gain +([\d.]+) in L2", said)
    assert float(gain) > 5  # a mesh worth having
    (observed, predicted), *_ = re.findall(r"observed rate ([\d.]+), predicted rate ([\d.]+)", said)
    assert float(predicted) == pytest.approx(float(observed), rel=0.05)
    assert said.count("predicted rate") == 1  # that of the default settings leaves out what decides there


def test_a_service_that_does_not_start_gives_its_reason_and_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    equimesh_service = pytest.importorskip("equimesh_service")
    from equimesh_service.errors import NotStartedError

    def broken(*_: object, **__: object) -> None:
        logging.getLogger("equimesh_service.server").info("what the log says")
        raise NotStartedError("the service did not start: no space")

    monkeypatch.setattr(equimesh_service, "running", broken)
    assert main(["demo", "--output", str(tmp_path / "out")]) == Exit.UNREACHABLE
    log = tmp_path / "out" / "demo.log"
    said = capsys.readouterr().err
    assert "the service did not start: no space" in said
    assert str(log) in said
    assert "what the log says" in log.read_text()
