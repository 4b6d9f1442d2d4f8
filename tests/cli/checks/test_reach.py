"""Checks of how a service is reached."""

from __future__ import annotations

import socket

import pytest

from cli.conftest import look
from equimesh_cli.checks import reach
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings
from equimesh_service.store.store import Store

OK = Level.OK
WARNING = Level.WARNING
FAILED = Level.FAILED
pytestmark = pytest.mark.usefixtures("no_variables")


def test_a_port_that_is_taken(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = int(url.rpartition(":")[2])
    assert look(reach.port, Settings(port=ours)).message.startswith("a service of equimesh answers")
    monkeypatch.setattr(reach, "TIMEOUT_SECONDS", 0.5)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        found = look(reach.port, Settings(port=other.getsockname()[1]))
    assert (found.level, "another program" in found.message) == (FAILED, True)
    assert look(reach.port, Settings(port=0)).level is OK
    assert look(reach.port, Settings(host="192.0.2.1", port=0)).level is FAILED


def test_an_address_of_others_without_a_key(made: Settings) -> None:
    public = made.model_copy(update={"host": "0.0.0.0"})
    assert look(reach.exposure, public).level is FAILED
    assert look(reach.exposure, public.model_copy(update={"allow_anonymous": True})).level is WARNING
    assert look(reach.exposure, made).level is OK
    store = Store(made.database)
    store.keys.create("test", ["read"])
    store.close()
    assert look(reach.exposure, public).level is OK
