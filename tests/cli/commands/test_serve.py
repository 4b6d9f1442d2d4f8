"""`equimesh serve`: its options."""

from __future__ import annotations

import gc

import pytest

from equimesh_cli import main


def test_serve_has_an_option_for_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    settings = pytest.importorskip("equimesh_service.settings").Settings
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    said = capsys.readouterr().out
    for name in settings.model_fields:
        assert f"--{name.replace('_', '-')} " in said
    for title in ("network", "work", "limits", "storage", "keys and quotas", "logs and metrics"):
        assert f"\n{title}:\n" in said
    assert main(["serve", "--port", "many", "--lease", "-1"]) == 2
    assert gc.isenabled()  # as before, in a program that goes on
    said = capsys.readouterr().err
    assert "--port (or EQUIMESH_PORT) = many" in said
    assert "--lease (or EQUIMESH_LEASE) = -1" in said
