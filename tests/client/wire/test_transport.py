"""The address of a service, and what goes to it with every request."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import BadArgument


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "ftp://x", "http://", "nonsense", "http://[::1"])
def test_a_url_that_is_none(connect: Any, url: str) -> None:
    with pytest.raises(BadArgument):
        connect(url)


def test_headers_go_with_every_request(connect: Any, service: Any) -> None:
    connect(service.url, headers={"Authorization": "Bearer me"}).generate("x", 5).events()
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer me"}
