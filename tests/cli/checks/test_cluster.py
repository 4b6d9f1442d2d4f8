"""The check of a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from distributed import LocalCluster

from cli.conftest import look
from equimesh_cli.checks import reach as module
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings
from equimesh_service.engine import examination
from equimesh_service.files.address import files_address
from equimesh_service.worker.job import Storage
from equimesh_service.worker.reach import MARK, Reach

pytestmark = pytest.mark.usefixtures("no_variables")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster in threads of this process, of one worker with two threads."""
    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp://", dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster


def with_cluster(settings: Settings, address: str) -> Settings:
    """The settings with the engine dask."""
    return settings.model_copy(update={"engine": "dask", "scheduler": address, "memory_limit": 16})


def test_a_service_without_a_cluster_needs_none(here: Settings) -> None:
    assert module.cluster(here) is None


def test_a_cluster_that_can_be_used(made: Settings, cluster: Any) -> None:
    settings = with_cluster(made, cluster.scheduler_address)
    found = look(module.cluster, settings)
    assert (found.level, found.message) == (
        Level.OK,
        f"the cluster at {cluster.scheduler_address}: 1 workers solve 2 meshes at the same time, in the versions of "
        "this service; the first start checks what they reach",
    )
    files = files_address(settings)
    files.open().prepare(alone=True)
    Reach.of(Storage(settings.database, files))
    assert look(module.cluster, settings).message.endswith("all reach the database and the files")
    large = look(module.cluster, settings.model_copy(update={"memory_limit": 1 << 30}))
    assert (large.level, "for 2 meshes of 1073741824 MiB each" in large.message) == (Level.WARNING, True)


def test_workers_that_cannot_be_used(made: Settings, cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = with_cluster(made, cluster.scheduler_address)
    files = files_address(settings)
    files.open().prepare(alone=True)
    reach = replace(Reach.of(Storage(settings.database, files)), folder="of another service")
    monkeypatch.setattr(Reach, "of", lambda *_, **__: reach)
    found = look(module.cluster, settings)
    assert found.level is Level.FAILED
    assert f"it does not see the folder of the service's files, {files.folder}" in found.message
    assert (files.folder / MARK).exists()
    here = examination.versions()
    monkeypatch.setattr(examination, "describe_difference", lambda *_: "equimesh 0.1.0 in place of " + here["equimesh"])
    assert "it has equimesh 0.1.0 in place of" in look(module.cluster, settings).message


def test_a_scheduler_that_cannot_be_reached(made: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examination, "_MAX_CONNECT_SECONDS", 0.5)
    found = look(module.cluster, with_cluster(made, "tcp://127.0.0.1:9"))
    assert found.level is Level.FAILED
    assert found.message == "the scheduler at tcp://127.0.0.1:9 cannot be reached (OSError)"


@pytest.mark.parametrize(
    ("address", "is_open"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("tcp://[::1]:8786", False),
        ("tls://10.0.0.5:8786", False),
        ("tcp://10.0.0.5:8786", True),
        ("tcp://0.0.0.0:8786", True),
        ("ucx://first:8786", True),
    ],
)
def test_a_scheduler_that_others_reach_without_tls_is_open(address: str, is_open: bool) -> None:
    assert module.is_open(address) == is_open


def test_an_open_cluster_is_warned_of(made: Settings) -> None:
    where = {"protocol": "tcp://", "host": "0.0.0.0", "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **where) as opened:
        port = opened.scheduler.port
        found = look(module.cluster, with_cluster(made, f"tcp://127.0.0.1:{port}"))
    assert found.level is Level.WARNING
    assert "can run programs on all of them" in found.message
    assert "dask scheduler --host 127.0.0.1" in found.remedy
