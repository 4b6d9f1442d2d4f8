"""The API key: where it comes from and where it goes."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import BadArgument, ProblemError
from equimesh_client.wire.settings import headers_with_key


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_the_key_goes_with_every_request_and_nowhere_else(
    connect: Any, service: Any, fault: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_environment\n")
    connect(service.url).generate("x", 5)
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_1_environment"}
    requested = [
        ({"key": "em_2_given"}, "Bearer em_2_given"),
        ({"key": ""}, None),
        ({"headers": {"authorization": "Basic me"}}, "Basic me"),
    ]
    for options, header in requested:
        connect(service.url, **options).capabilities()
        assert service.requests[-1].headers.get("authorization") == header
    for options in ({"key": "em_2", "headers": {"AUTHORIZATION": "x"}}, {"key": "em 2"}, {"key": "em_\u00e4"}):
        with pytest.raises(BadArgument) as caught:
            connect(service.url, **options)
        assert "em_" not in str(caught.value)
        assert "em 2" not in str(caught.value)
    # a redirect is not followed: the key is for this address
    other = f"{service.url}/v1/elsewhere"
    service.faults = [fault("capabilities", "status", status=307, headers={"Location": other})]
    with pytest.raises(ProblemError, match=other):
        connect(service.url).capabilities()
    assert service.seen("GET", "elsewhere") == []


def test_the_environment_gives_the_key_unless_there_is_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_a ")
    assert headers_with_key(None, None) == {"Authorization": "Bearer em_1_a"}
    assert headers_with_key({"X": "1"}, "em_2_b") == {"X": "1", "Authorization": "Bearer em_2_b"}
    assert headers_with_key(None, "") == {}
    assert headers_with_key({"authorization": "Basic x"}, None) == {"authorization": "Basic x"}


def test_a_key_that_cannot_be_one_is_refused_and_not_shown() -> None:
    with pytest.raises(BadArgument, match="not both"):
        headers_with_key({"authorization": "Basic x"}, "em_1_a")
    for key in ("em 1", "em_\n1", "em_\u00e9"):
        with pytest.raises(BadArgument, match="the key has a space") as caught:
            headers_with_key(None, key)
        assert key not in str(caught.value)
