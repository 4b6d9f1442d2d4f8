"""The benchmark of a service under load counts what really came back. Nothing here looks at a clock."""

from __future__ import annotations

import httpx
import load
import pytest

pytestmark = pytest.mark.needs("wrk")
SMALL = load.Load(name="two callers", points=9, format="npz", connections=2)


def test_every_request_is_a_mesh_of_its_own(http: httpx.Client, url: str) -> None:
    before = meshes(http)
    for _ in range(20):  # on a busy machine no mesh may be finished in a second
        found = load.measure(url, SMALL, 1, warm_up=1)
        if found["made"] > 0:
            break
    assert found["made"] > 0
    assert found["refused"] == found["failed"] == 0
    # Those of the warm-up are there, too, and those that were under way at an end.
    assert meshes(http) - before >= found["made"]
    assert found["rate"] == pytest.approx(found["made"] / found["seconds"])


def test_refusals_are_counted_as_such(url: str) -> None:
    wrong = load.Load(name="no such format", points=9, format="stl", connections=2)
    found = load.measure(url, wrong, 1, warm_up=1)
    assert found["made"] == 0
    assert found["refused"] > 0


def meshes(http: httpx.Client) -> float:
    """How many meshes have succeeded so far."""
    for line in http.get("/metrics").text.splitlines():
        if line.startswith("equimesh_meshes_finished_total") and 'status="succeeded"' in line:
            return float(line.split()[-1])
    return 0.0
