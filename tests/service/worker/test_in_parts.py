"""What becomes of a mesh in parts that the cluster does not compute."""

from types import SimpleNamespace
from typing import Any

import pytest

from equimesh_cluster import ClusterError, NoSchedulerError
from equimesh_service.errors import WorkerLostError
from equimesh_service.problems.problem import Problem
from equimesh_service.worker import in_parts


def solve_with(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve a mesh whose computation raises ``error``."""

    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(in_parts, "_compute", fail)
    job: Any = SimpleNamespace(claim=SimpleNamespace(mesh_id="m"))
    store: Any = SimpleNamespace(queue=SimpleNamespace(progress=print))
    in_parts.solve_in_parts(job, SimpleNamespace(), store, None)  # type: ignore[arg-type]


def test_a_scheduler_out_of_reach_ends_the_attempt_and_not_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(WorkerLostError, match="lost the cluster"):
        solve_with(NoSchedulerError("no scheduler answers at tcp://10.0.0.7:8786"), monkeypatch)


@pytest.mark.parametrize(
    ("told", "shown"),
    [
        ("the worker tcp://10.0.0.7:4501 has 1 GB left", "a worker has 1 GB left"),
        ("the machine 10.0.0.7 has 1 GB free", "a machine has 1 GB free"),
        ("versions differ: tls://[fe80::1]:4501 has numpy 2.1", "versions differ: a worker has numpy 2.1"),
    ],
)
def test_a_refusal_names_no_address(told: str, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Problem) as refused:
        solve_with(ClusterError(told), monkeypatch)
    assert refused.value.name == "cluster-refused"
    assert refused.value.body()["detail"] == f"{shown}."
