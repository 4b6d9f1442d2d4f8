"""The workers of a cluster, as a service knows them."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from equimesh_service.engine import dask as module
from equimesh_service.engine.cluster_pool import PoolReport
from equimesh_service.engine.dask import Member, Members

HERE = {"equimesh": "0.3.0"}
POOL = "equimesh-0"


def known(name: str, seen: float = 1.0, status: str = "running", **report: Any) -> dict[str, Any]:
    """What a scheduler knows of a worker; with ``report`` it has a pool."""
    made = {"identity": name, "slots": 2, "versions": HERE, "ready": True, **report}
    metrics = {POOL: PoolReport(**made).packed()} if report else {}
    return {"name": name, "status": status, "last_seen": seen, "metrics": metrics}


def test_a_worker_counts_once_its_pool_is_ready() -> None:
    members = Members(HERE, POOL)
    assert members.describe() == "there are no workers"
    assert members.update({"a": known("one")}) == []
    assert (members.slots, members.describe(), members.find_free()) == (0, "workers are starting", None)
    members.update({"a": known("one", ready=False)})
    assert (members.slots, members.describe()) == (0, "workers are starting")
    members.update({"a": known("one", ready=True), "b": known("two", slots=3)})
    assert (members.slots, members.describe()) == (5, "")
    free = members.find_free()
    assert (free.name, free.free) == ("two", 3)
    free.jobs.update({"x", "y"})
    assert members.find_free() is not free


def test_workers_are_refused_with_a_reason() -> None:
    members = Members(HERE, POOL)
    found = {
        "a": known("old", versions={"equimesh": "0.2.0"}),
        "b": known("blind", fault="it sees nothing", ready=False),
        "c": known("paused", status="paused", slots=1),
        "d": known("well", slots=1),
    }
    members.update(found)
    assert members.slots == 1
    assert members.refusals() == [
        "worker old is not used: it has equimesh 0.2.0 in place of 0.3.0",
        "worker blind is not used: it sees nothing",
        "worker paused is not used: it is paused",
    ]
    members.update({**found, "e": known("also", versions={})})
    assert members.describe().endswith("; and 1 more")


def test_a_worker_that_is_gone_silent_or_another_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    members = Members(HERE, POOL)
    members.update({"a": known("one", slots=1), "b": known("two", slots=1), "c": known("three", slots=1)})
    one, two, three = members
    assert members.update({"a": known("one", slots=1), "b": known("two", identity="new")}) == [three, two]
    assert [member.name for member in members] == ["one", "two"]
    assert two not in members
    assert members.slots == 3
    late = time.monotonic() + module.MAX_SILENT_SECONDS + 1.0
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: late))
    assert members.update({"a": known("one", slots=1), "b": known("two", seen=2.0, identity="new")}) == [one]


def test_visits_are_repeated_and_tell_what_is_missing() -> None:
    members = Members(HERE, POOL)
    members.update({"a": known("one")})
    (one,) = members.find_unvisited()
    one.note_visit(None)
    assert members.find_unvisited() == []
    members.update({"a": known("one", slots=2)})
    members.update({"a": known("one")})  # its pool was closed
    assert members.find_unvisited() == [one]
    one.note_visit(ModuleNotFoundError("No module named 'equimesh_service'"))
    assert members.describe() == (
        "worker one is not used: it has no equimesh of this release (No module named 'equimesh_service')"
    )
    one.note_visit(OSError("gone"))
    assert "OSError: gone" in members.describe()
    assert isinstance(one, Member)
