"""The work of a worker on a mesh that is not kept."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_service import Settings
from equimesh_service.admission.callers import ANYONE
from equimesh_service.admission.computation import Computation, ComputationResult, Request, answer, compute
from equimesh_service.engine.port import PackedCall, open_outcome, pack_outcome
from equimesh_service.errors import TimeLimitError
from equimesh_service.files.address import files_address
from equimesh_service.problems.problem import Problem
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import Claim, Lease, NoMesh
from equimesh_service.store.store import Store
from equimesh_service.worker.job import DRAWING, Storage
from service.conftest import small
from service.requests import npz

AXIS = np.linspace(0.0, 1.0, 6)


def task(folder: Path, spec: dict[str, Any], **more: Any) -> Computation:
    settings = Settings(data_dir=folder)
    folder.joinpath("files").mkdir(exist_ok=True)
    store = Store(settings.database)
    store.prepare()
    store.close()
    known: dict[str, Any] = {
        "body": json.dumps(spec).encode(),
        "content_type": "application/json",
        "format": DRAWING,
        "seconds": 600.0,
        **more,
    }
    return Computation(
        caller=ANYONE, settings=settings, storage=Storage(settings.database, files_address(settings)), **known
    )


def files(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob("*") if path.is_file() and "sqlite" not in path.name]


def test_samples_of_the_request_leave_no_file(tmp_path: Path) -> None:
    spec = small(monitor={"kind": "arc_length", "u": {"samples": "upload"}})
    body = npz(spec=json.dumps(spec), x=AXIS, y=AXIS, values=np.add.outer(AXIS**2, AXIS))
    computed = compute(task(tmp_path, spec, body=body, content_type="application/x-npz"))
    with np.load(io.BytesIO(computed.content)) as drawing:
        assert drawing["u"][-1, -1] == pytest.approx(2.0)
    assert (computed.ending.uploads, files(tmp_path)) == (1, [])


def test_a_task_crosses_to_a_cluster(tmp_path: Path) -> None:
    """As the engine of a cluster sends it: as bytes."""
    good = PackedCall.of(compute, task(tmp_path, small(schwarz={}), frames=True))
    computed: ComputationResult = open_outcome(pack_outcome(good))
    with np.load(io.BytesIO(computed.content)) as drawing:
        frames = json.loads(drawing["document"].tobytes())["frames"]
        assert drawing["frames_x"].shape == (len(frames), 8, 9)
    wrong = small(monitor={"kind": "curvature", "u": "sqrt(x - 2)", "smoothing": 0.1})
    with pytest.raises(Problem, match="not finite"):
        open_outcome(pack_outcome(PackedCall.of(compute, task(tmp_path, wrong))))


def test_only_the_service_refuses_for_meshes_in_flight(tmp_path: Path) -> None:
    """It knows which of them are still there."""
    sent = task(tmp_path, small())
    of_task = {name: getattr(sent, name) for name in ("content_type", "body", "caller", "settings", "storage")}
    quota = Quota(queued=1, points=0, in_flight=("gone",))
    known: dict[str, Any] = {"format": None, "key": None, "reuse": False, "quota": quota}
    end = answer(Request(**of_task, **known, claim=Claim("m", 1), lease=Lease(owner="me", seconds=60.0)))
    assert isinstance(end, NoMesh)
    assert (end.error, end.admitted.spec["grid"]) == (None, small()["grid"])


def test_a_solve_ends_itself_at_its_limit(tmp_path: Path) -> None:
    """The worker lives on, which the engine would have to kill."""
    with pytest.raises(TimeLimitError):
        compute(task(tmp_path, small(schwarz={}), seconds=0.0))


def test_the_problem_of_a_failed_solve_is_the_answer_for_its_file(tmp_path: Path) -> None:
    classical = {"transmission": {"kind": "classical"}, "max_iterations": 2, "tolerance": 1e-10, "fallback": False}
    said = json.loads(compute(task(tmp_path, small(schwarz=classical), format=None)).content)
    assert (said["status"], said["error"]["type"]) == ("failed", "/problems/not-converged")
    with pytest.raises(Problem) as caught:
        compute(task(tmp_path, small(schwarz=classical), format="vtu"))
    assert caught.value.name == "not-converged"


@pytest.mark.parametrize("kind", ["arc_length", "curvature", "auto"])
def test_what_a_preview_costs(tmp_path: Path, kind: str) -> None:
    """A drawing is small next to what it draws."""
    more = {"smoothing": 0.1} if kind == "curvature" else {}
    spec = small(monitor={"kind": kind, "u": "tanh(8*(x + y/2 - 0.75))", **more}, grid={"n_xi": 65, "n_eta": 65})
    assert len(compute(task(tmp_path, spec)).content) < 64 * 65 * 65 + 20_000
