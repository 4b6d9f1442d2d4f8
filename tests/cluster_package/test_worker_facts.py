"""What workers say about themselves."""

from __future__ import annotations

from dataclasses import replace

import pytest
from distributed import Client, Status, Worker

from equimesh_cluster import ClusterError
from equimesh_cluster import workers as module
from equimesh_cluster.workers import PACKAGES, check_versions, examine_scheduler, examine_workers, versions


def test_workers_say_who_they_are_and_what_they_have(client: Client) -> None:
    facts = examine_workers(client)
    assert [one.address for one in facts] == sorted(client.nthreads())
    assert len({one.identity for one in facts}) == 3
    assert {one.threads for one in facts} == {2}
    assert all(one.versions == versions() and set(one.versions) == set(PACKAGES) for one in facts)
    assert all(one.used > 0 and one.free > 0 and one.limit == 0 for one in facts)
    (one,) = examine_workers(client, [facts[1].address])
    assert one == replace(facts[1], used=one.used, free=one.free)


def test_a_worker_that_is_gone_is_left_out(client: Client) -> None:
    assert examine_workers(client, ["tcp://127.0.0.1:9"]) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_another_version_is_refused_by_name(client: Client, package: str) -> None:
    facts = examine_workers(client)
    found = {facts[0].address: facts[0].versions, facts[1].address: {**facts[1].versions, package: "0.0.1"}}
    pattern = f"versions differ: {facts[1].address} has {package} 0.0.1, and {versions()[package]} is here. Install"
    with pytest.raises(ClusterError, match=pattern):
        check_versions(found)


def test_a_scheduler_of_another_version_is_refused(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    examine_scheduler(client)

    def older() -> dict[str, str]:
        return {**here, "equimesh": "0.0.1"}

    here = versions()
    with monkeypatch.context() as patch:
        patch.setattr(client, "run_on_scheduler", lambda _: older())
        with pytest.raises(ClusterError, match=r"the scheduler has equimesh 0\.0\.1, and"):
            examine_scheduler(client)


def test_a_worker_without_equimesh_is_refused_by_name(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ModuleNotFoundError("No module named 'equimesh'")

    monkeypatch.setattr(module, "examine", missing)
    with pytest.raises(ClusterError, match=r"has no equimesh .*No module named.*: install equimesh\[dask\]==") as error:
        examine_workers(client)
    assert any(address in str(error.value) for address in client.nthreads())


def test_a_worker_that_takes_no_tasks_is_refused_by_name_and_one_that_ends_is_left_out(client: Client) -> None:
    def become(status: Status, dask_worker: Worker) -> None:
        dask_worker.status = status

    first, *others = sorted(client.nthreads())
    try:
        client.run(become, Status.paused, workers=[first])
        with pytest.raises(ClusterError, match=f"paused, so that they take no tasks: {first}. Dask pauses"):
            examine_workers(client)
        assert [one.address for one in examine_workers(client, others)] == others
        client.run(become, Status.closing_gracefully, workers=[first])
        assert [one.address for one in examine_workers(client)] == others
    finally:
        client.run(become, Status.running, workers=[first])
    assert [one.status for one in examine_workers(client)] == ["running"] * 3
