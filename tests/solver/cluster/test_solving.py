"""One mesh on the workers of a cluster."""

from __future__ import annotations

import pytest
from distributed import Client

from equimesh import InputError
from equimesh.cluster import ClusterError, solve
from meshes_on_workers import PROBLEM


def test_arguments_that_cannot_be_used_are_refused(client: Client) -> None:
    with pytest.raises(InputError, match="problem = 'u' is no problem"):
        solve("u", client)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="client = '7' is no client"):
        solve(PROBLEM, 7)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="mode"):
        solve(PROBLEM, client, mode="loose")  # type: ignore[arg-type]


def test_an_address_without_a_scheduler_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.cluster.connection.CONNECT_SECONDS", 0.2)
    with pytest.raises(ClusterError, match=r"no scheduler answers at tcp://127\.0\.0\.1:9 .*start one with"):
        solve(PROBLEM, "tcp://127.0.0.1:9")
