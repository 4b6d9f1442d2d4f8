"""`equimesh worker`: what it refuses; tests of the cluster start it."""

from __future__ import annotations

import sys

import pytest

from equimesh_cli import main

pytestmark = pytest.mark.usefixtures("no_variables")


def test_a_worker_needs_a_scheduler(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["worker"]) == 2
    said = capsys.readouterr().err
    assert said == "equimesh: the engine dask needs a scheduler: give its address, like tcp://host:8786\n"
    assert main(["worker", "--scheduler", "tcp://host:8786", "--workers", "none"]) == 2
    assert "--workers (or EQUIMESH_WORKERS) = none" in capsys.readouterr().err


def test_without_dask_it_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "equimesh_service.engine.cluster_worker", raising=False)
    assert main(["worker", "--scheduler", "tcp://host:8786"]) == 2
    assert "pip install 'equimesh[dask]'" in capsys.readouterr().err
