"""`equimesh check`, here and at a service."""

from __future__ import annotations

import json
from typing import Any

import pytest

from equimesh_cli import main


def test_check_at_a_service(service: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "x", "--url", service.url]) == 0
    assert capsys.readouterr().out == "ok\n  names: x, y\n"
    assert main(["check", "foo", "--url", service.url]) == 2
    assert capsys.readouterr().err.endswith("      foo\n      ^\n")


def test_check_on_a_domain(service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("scipy")
    monkeypatch.delenv("EQUIMESH_URL", raising=False)
    assert main(["check", "log(x*x+y*y)", "--domain", "annulus:1,2,0,90"]) == 0
    assert main(["check", "log(x)", "--domain", "rectangle:-1,1,0,1"]) == 2
    assert main(["check", "x", "--domain", "rectangle:0,2,0,1", "--url", service.url]) == 0
    assert json.loads(service.seen("POST", "check")[0].body)["domain"]["x"] == [0, 2]


def test_check_here(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("scipy")
    monkeypatch.delenv("EQUIMESH_URL", raising=False)
    assert main(["check", "c*x", "--parameter", "c=2"]) == 0
    assert "u: 0 to 2" in capsys.readouterr().out
    assert main(["check", "x*y"]) == 0
    assert "understood" not in capsys.readouterr().out
    assert main(["check", "2x − π|y|"]) == 0
    assert "  understood: 2*x - pi*abs(y)\n" in capsys.readouterr().out
    assert main(["check", "1 + foo(x)"]) == 2
    said = capsys.readouterr().err
    assert "foo" in said
    assert said.endswith("    1 + foo(x)\n        ^\n")
