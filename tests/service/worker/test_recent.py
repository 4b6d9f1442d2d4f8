"""What stays in a worker between the steps of a sequence is what it would read again, to the bit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace as Namespace
from typing import Any, BinaryIO

import numpy as np
import pytest

import equimesh as em
from equimesh.io.npz import load_mesh, load_npz
from equimesh.io.write import mesh_bytes
from equimesh.specs import build
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import MeshInput
from equimesh_service.worker import recent, solve
from equimesh_service.worker.recent import Recent, as_read

GRID = {"n_xi": 13, "n_eta": 9}


class Folder:
    """Files by their names, and which of them were read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.read: list[str] = []

    def require(self, name: str) -> None:
        if not (self.folder / name).exists():
            raise FileNotFoundError(name)

    @contextmanager
    def opened(self, name: str) -> Iterator[BinaryIO]:
        self.require(name)
        self.read.append(name)
        with (self.folder / name).open("rb") as stream:
            yield stream


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(solve, "MESHES", Recent())
    monkeypatch.setattr(solve, "FUNCTIONS", Recent())
    return Folder(tmp_path)


def test_a_step_from_a_mesh_and_a_function_that_stayed_is_that_of_a_new_worker_to_the_bit(files: Any) -> None:
    first = em.solve(build({"monitor": {"u": "tanh(9*(x - 0.4))", "kind": "arc_length"}, "grid": GRID}).problem)
    (files.folder / "mesh").write_bytes(mesh_bytes(first.data(), format="npz"))
    nodes = first.mesh
    np.savez(files.folder / "u.npz", x=nodes.x, y=nodes.y, values=np.tanh(9.0 * (nodes.x - 0.4)))
    spec = build({"monitor": {"u": "tanh(9*(x - 0.45))", "kind": "least_error"}, "grid": GRID})
    before = {"u": {"samples": "n-1"}, "samples": "u.npz", "gains": {"l2": 2.0}}
    task = MeshInput(spec={}, samples={}, format=None, start="mesh", settings={"before": before})

    def step() -> em.Mesh:
        start = solve.StepStart.of(task, spec, files)
        assert start is not None
        return start.take(spec, {"threads": 1, "check": False}).mesh

    read, kept = step(), step()
    assert files.read == ["mesh", "u.npz"], "each once"
    solve.MESHES = Recent()
    solve.MESHES.keep("mesh", as_read(first.mesh))
    made = step()
    assert len(files.read) == 2, "the mesh that was computed is not read"
    for other in (kept, made):
        np.testing.assert_array_equal(other.points, read.points)
    solve.MESHES, solve.FUNCTIONS = Recent(), Recent()
    np.testing.assert_array_equal(step().points, read.points)
    assert len(files.read) == 4, "a new worker reads both"


def test_what_was_deleted_is_not_used_where_it_stayed(files: Any) -> None:
    solution = em.solve(build({"monitor": {"rho": "1 + x", "kind": "weight"}, "grid": GRID}).problem)
    (files.folder / "mesh").write_bytes(mesh_bytes(solution.data(), format="npz"))
    mesh = solution.mesh
    np.savez(files.folder / "u.npz", x=mesh.x, y=mesh.y, values=mesh.x)
    before = {"u": {"samples": "n-1"}, "samples": "u.npz", "gains": {}}
    spec = {"monitor": {"u": {"samples": "n-1"}, "kind": "arc_length"}, "grid": GRID}
    task = MeshInput(spec=spec, samples={"n-1": "u.npz"}, format=None, start="mesh", settings={"before": before})
    job: Any = Namespace(mesh_input=task, packed=None)
    store: Any = None
    built = solve._build(job, store, files).spec
    (files.folder / "u.npz").unlink()
    with pytest.raises(Problem, match="The samples of this mesh were deleted"):
        solve._build(job, store, files)
    start = solve.StepStart.of(task, built, files)
    assert start is not None
    assert start.earlier is not None
    assert start.earlier.u is None
    (files.folder / "mesh").unlink()
    with pytest.raises(Problem, match="The mesh that this step starts from was deleted"):
        solve.StepStart.of(task, built, files)


def test_a_computed_grid_is_as_it_is_read(tmp_path: Path) -> None:
    for domain in (em.Rectangle(), em.AnnulusSector(closed=True)):
        problem = em.Problem(
            monitor=em.Weight(rho=em.Expression("1 + x*x")), grid=em.Grid(n_xi=9, n_eta=7), domain=domain
        )
        solution = em.solve(problem)
        (tmp_path / "mesh.npz").write_bytes(mesh_bytes(solution.data(), format="npz"))
        read = load_npz(tmp_path / "mesh.npz").mesh
        meshes = as_read(solution.mesh), load_mesh(tmp_path / "mesh.npz")
        names = ("x", "y", "ties")
        for one, other in ((getattr(read, name), getattr(mesh, name)) for name in names for mesh in meshes):
            np.testing.assert_array_equal(one, other)
            assert (one.dtype, one.flags.c_contiguous, one.flags.writeable) == (
                other.dtype,
                other.flags.c_contiguous,
                other.flags.writeable,
            )


def test_the_last_small_ones_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    last, made = Recent(), []

    def get(key: int) -> None:
        last.get(key, lambda: made.append(key) or em.Mesh.uniform(em.Grid(n_xi=4, n_eta=4)), lambda: None)

    for key in (1, 2, 3, 4, 1, 5, 1, 2):
        get(key)
    assert made == [1, 2, 3, 4, 5, 2]
    monkeypatch.setattr(recent, "MAX_POINTS", 15)
    for _ in range(2):
        get(9)
    assert made[-2:] == [9, 9]
    formula: Any = em.Expression("x")
    last.keep("u", formula)
    assert last.get("u", lambda: None, lambda: None) is None, "what is not at nodes may change with its use"
