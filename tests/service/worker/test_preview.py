"""The task of a preview in a worker."""

from __future__ import annotations

import io
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_service.engine.port import PackedCall, open_outcome, pack_outcome
from equimesh_service.errors import TimeLimitError
from equimesh_service.files.folder import FolderFiles
from equimesh_service.problems.problem import Problem
from equimesh_service.spec.mesh import read_spec
from equimesh_service.worker.job import Storage
from equimesh_service.worker.preview import Preview, draw_preview
from service.conftest import small
from service.requests import npz

SAMPLED = small(monitor={"kind": "arc_length", "u": {"samples": "s-1"}})
AXIS = np.linspace(0.0, 1.0, 6)
SAMPLES = npz(x=AXIS, y=AXIS, values=np.add.outer(AXIS**2, AXIS))


class Address:
    """The address of a folder of files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def open(self) -> FolderFiles:
        return FolderFiles(self.folder)


def task(folder: Path, spec: dict[str, Any], **more: Any) -> Preview:
    known: dict[str, Any] = {"stored": {}, "sent": {}, **more}
    address: Any = Address(folder)
    return Preview(spec=read_spec(spec).canonical, storage=Storage("", address), **known)


def test_the_samples_of_the_request_need_no_file(tmp_path: Path) -> None:
    content = draw_preview(task(tmp_path, SAMPLED, sent={"s-1": SAMPLES}))
    with np.load(io.BytesIO(content)) as drawing:
        assert drawing["u"][-1, -1] == pytest.approx(2.0)
    assert [*tmp_path.iterdir()] == []


def test_stored_samples_that_are_gone_are_a_conflict(tmp_path: Path) -> None:
    with pytest.raises(Problem) as caught:
        draw_preview(task(tmp_path, SAMPLED, stored={"s-1": "0" * 64}))
    assert caught.value.name == "conflict"


def test_a_task_and_its_problem_cross_to_a_cluster(tmp_path: Path) -> None:
    """As the engine of a cluster sends them: as bytes."""
    good = PackedCall.of(draw_preview, task(tmp_path, small(schwarz={}), frames=True))
    with np.load(io.BytesIO(open_outcome(pack_outcome(good)))) as drawing:
        frames = json.loads(drawing["document"].tobytes())["frames"]
        assert drawing["frames_x"].shape == (len(frames), 8, 9)
    wrong = small(monitor={"kind": "curvature", "u": "sqrt(x - 2)", "smoothing": 0.1})
    with pytest.raises(Problem, match="not finite"):
        open_outcome(pack_outcome(PackedCall.of(draw_preview, task(tmp_path, wrong))))


def test_a_solve_ends_itself_at_its_limit(tmp_path: Path) -> None:
    """The worker lives on, which the engine would have to kill."""
    with pytest.raises(TimeLimitError):
        draw_preview(task(tmp_path, small(schwarz={}), seconds=0.0))
    assert draw_preview(task(tmp_path, small(schwarz={}), seconds=600.0))


@pytest.mark.parametrize("kind", ["arc_length", "curvature", "auto"])
def test_what_a_preview_costs(tmp_path: Path, kind: str) -> None:
    """Printed: processor time of the worker at 65 x 65. A drawing costs little next to what it draws at 257 x 257."""
    more = {"smoothing": 0.1} if kind == "curvature" else {}
    for n in (65, 257) if kind == "arc_length" else (65,):
        spec = small(monitor={"kind": kind, "u": "tanh(8*(x + y/2 - 0.75))", **more}, grid={"n_xi": n, "n_eta": n})
        draw_preview(task(tmp_path, spec))
        began = time.process_time()
        content = draw_preview(task(tmp_path, spec))
        milliseconds = 1e3 * (time.process_time() - began)
        print(f"preview of {kind} at {n} x {n}: {milliseconds:.0f} ms of processor time, {len(content) // 1024} KiB")
        assert len(content) < 64 * n * n + 20_000
