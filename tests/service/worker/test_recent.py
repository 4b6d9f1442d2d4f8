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
from equimesh.io.npz import load_mesh, load_npz, npz_bytes
from equimesh.io.write import mesh_bytes
from equimesh.specs import build
from equimesh_service.assembly.bodies import StepField, field_arrays
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import MeshInput
from equimesh_service.worker import recent, solve
from equimesh_service.worker.recent import KnownStep, Recent, as_read

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


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_step_of_which_the_check_is_known_is_the_one_that_is_read_to_the_bit(files: Any, is_closed: bool) -> None:
    domain = {"domain": {"kind": "annulus_sector", "closed": True}} if is_closed else {}
    first = em.solve(build({"monitor": {"rho": "1 + x*x", "kind": "weight"}, "grid": GRID, **domain}).problem)
    mesh = as_read(first.mesh)
    (files.folder / "mesh").write_bytes(mesh_bytes(first.data(), format="npz"))
    values = np.tanh(9.0 * mesh.x * mesh.y)
    np.savez(files.folder / "u.npz", x=mesh.x, y=mesh.y, values=values)
    # As they come with a request: in the order of Fortran, and such that they cannot be written to.
    sent = {
        "p": StepField(values=np.asfortranarray(mesh.x + mesh.y)),
        "q": StepField(values=mesh.y, transfer="conservative"),
    }
    for array in (values, *(field.values for field in sent.values())):
        array.flags.writeable = False
    (files.folder / "fields").write_bytes(npz_bytes(field_arrays(sent)))
    spec = {"monitor": {"u": {"samples": "n-1"}, "kind": "arc_length"}, "grid": GRID, **domain}
    task = MeshInput(spec=spec, samples={"n-1": "u.npz"}, start="mesh", fields="fields", settings={})
    known = KnownStep(mesh=mesh, fields=sent, values={"u.npz": values})

    found = []
    for made in (None, known):
        solve.MESHES, solve.FUNCTIONS = Recent(), Recent()
        files.read.clear()
        work = solve.build_work(task, files, known=made)
        assert (files.read == []) == (made is known)
        taken = [field.values for field in work.start.fields.values()]
        assert all(array.flags.writeable and array.flags.c_contiguous for array in taken)
        step = work.start.take(work.spec, {"threads": 1, "check": False})
        u = work.spec.problem.monitor.u
        assert solve.FUNCTIONS.get(("u.npz", work.spec.problem.domain.box), pytest.fail, lambda: None) is u
        found.append(
            (
                step.mesh.points,
                u.values,
                u.values.flags.writeable,
                u.values.flags.c_contiguous,
                *step.fields.values(),
                step.certificate.summary(),
            )
        )
    for one, other in zip(*found, strict=True):
        np.testing.assert_equal(one, other)
