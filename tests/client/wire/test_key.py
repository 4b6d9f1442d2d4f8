"""The API key: where it comes from and where it goes."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import (
    BadArgument,
    ProblemError,
)


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_the_key_goes_with_every_request_and_nowhere_else(
    connect: Any, service: Any, fault: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", " em_1_environment\n")
    connect(service.url).generate("x", 5)
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_1_environment"}
    asked = [
        ({"key": "em_2_given"}, "Bearer em_2_given"),
        ({"key": ""}, None),
        ({"headers": {"authorization": "Basic me"}}, "Basic me"),
    ]
    for options, header in asked:
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
