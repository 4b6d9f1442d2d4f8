"""The address of a service, as an option."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_cli import main
from equimesh_cli.command import build_parser


def test_the_environment_names_the_service(service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_URL", service.url)
    assert main(["generate", "x", "-n", "5", "--quiet"]) == 0
    assert build_parser().parse_args(["check", "x"]).url == service.url
