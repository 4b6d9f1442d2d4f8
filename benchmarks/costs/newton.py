"""The sweeps compared with guarded Newton and a sparse direct solver, on the same grids from the same start."""

import importlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import equimesh as em
from costs.rows import Row, cpu_seconds
from costs.solves import front
from equimesh.meshes.nested import distance, nested_grids, prolong
from equimesh.meshes.rows import Rows
from equimesh.numerics import newton
from equimesh.single_domain.level import TIGHT_DEVIATION
from equimesh.sweeps.sweep import Sweep, memory_needed

Array: TypeAlias = npt.NDArray[np.float64]
Factorise: TypeAlias = Callable[[Any], newton.Solver]

LARGE = 513
"""Points a side for which the goals are."""
SUPERLU_GOAL = 200.0
"""CPU time with SuperLU over that of the sweeps, at least."""
PARDISO_GOAL = 30.0
"""CPU time with MKL PARDISO over that of the sweeps, at least."""
MAX_SWEEPS = 100
"""Sweeps of one level."""
PARDISO = "MKL PARDISO"


@dataclass(frozen=True, kw_only=True)
class Solver:
    """A solver for the linear systems of Newton's method on one grid; ``reuse`` keeps useful factorisations."""

    name: str
    factorise: Callable[[tuple[int, int]], Factorise]
    reuse: bool = False
    goal: float | None = None


@dataclass(frozen=True, kw_only=True)
class Solved:
    """CPU seconds and steps of Newton's method on every grid, and the finest mesh."""

    seconds: list[float]
    steps: list[int]
    mesh: em.Mesh


def compare(n: int) -> Iterator[Row]:
    """CPU time of Newton's method over that of the sweeps, on the finest level alone and for the whole solve."""
    problem = front(n)
    meshes = [em.solve(replace(problem, grid=grid), mode=em.Mode.TIGHT, threads=1).reference for grid in _coarse(n)]
    start = prolong(meshes[-1], problem.grid, meshes[-2])
    finest, (count, mesh) = cpu_seconds(lambda: sweep(problem, start))
    whole, _ = cpu_seconds(lambda: em.solve(problem, mode=em.Mode.TIGHT, threads=1))
    note = f"{finest:.3f} s, the whole solve {whole:.3f} s"
    counts = {"sweeps": count}
    what = f"n = {n}, sweeps on the finest level"
    yield Row(what=what, value=1e9 * finest / n**2, unit="ns/point", note=note, counts=counts)
    for solver in solvers():
        solved = solve(problem, solver)
        goal = solver.goal if n == LARGE else None
        total = sum(solved.seconds)
        note = (
            f"{solved.seconds[-1]:.1f} s, the whole solve {total:.1f} s = {total / whole:.0f} x;"
            f" meshes differ by {distance(solved.mesh, mesh):.0e}"
        )
        what, value = f"n = {n}, Newton with {solver.name}", solved.seconds[-1] / finest
        counts = {"steps": solved.steps[-1]}
        yield Row(what=what, value=value, unit="x the sweeps", goal=goal, at_least=True, note=note, counts=counts)


def solvers() -> list[Solver]:
    """SuperLU and, where pypardiso is installed, MKL PARDISO; each with and without kept factors."""

    def nested(shape: tuple[int, int]) -> Factorise:
        return lambda matrix: newton.factorise(matrix, shape)

    found = [
        Solver(name="SuperLU", factorise=lambda shape: newton.superlu, goal=SUPERLU_GOAL),  # noqa: ARG005
        Solver(name="SuperLU, dissection, factors kept", factorise=nested, reuse=True),
    ]
    if has_pardiso():
        found.append(Solver(name=PARDISO, factorise=lambda shape: pardiso(), goal=PARDISO_GOAL))  # noqa: ARG005
        found.append(Solver(name=f"{PARDISO}, factors kept", factorise=lambda shape: pardiso(), reuse=True))  # noqa: ARG005
    return found


def has_pardiso() -> bool:
    """Whether pypardiso and the library that it needs are installed."""
    try:
        importlib.import_module("pypardiso")
    except ImportError:
        return False
    return True


def pardiso() -> Factorise:
    """MKL PARDISO for systems of one pattern, which it orders only once."""
    library = importlib.import_module("pypardiso").PyPardisoSolver(mtype=11)
    is_ordered = False

    def factorise(matrix: Any) -> newton.Solver:
        nonlocal is_ordered
        rows = matrix.tocsr()  # with columns it solves the transposed system, and wrongly
        library._check_A(rows)
        library.set_phase(22 if is_ordered else 12)
        library._call_pardiso(rows, np.zeros((rows.shape[0], 1)))
        is_ordered = True

        def solve(right: Array) -> Array:
            library.set_phase(33)
            return np.asarray(library._call_pardiso(rows, right))

        return solve

    return factorise


def sweep(problem: em.Problem, start: em.Mesh) -> tuple[int, em.Mesh]:
    """The number of sweeps from ``start`` to the tolerance of tight mode, and the mesh."""
    memory = np.empty(memory_needed(problem.grid.shape))
    sweeps = Sweep(problem.metric, problem.boundary, Rows.whole(problem.grid.shape), memory)
    x, y = start.x.copy(), start.y.copy()
    for count in range(1, MAX_SWEEPS + 1):
        correction = sweeps.correct(x, y)
        x, y = sweeps.swap(x, y)
        if correction.deviation <= TIGHT_DEVIATION:
            return count, em.Mesh(x, y)
    raise RuntimeError(f"{MAX_SWEEPS} sweeps do not reach {TIGHT_DEVIATION}")


def solve(problem: em.Problem, solver: Solver) -> Solved:
    """Guarded Newton on every nested grid, from the start of the sweeps to the tolerance of tight mode."""
    meshes: list[em.Mesh] = []
    seconds, steps = [], []
    for grid in nested_grids(problem.grid):
        equations = replace(problem, grid=grid).equations()
        begun = time.process_time()
        start = prolong(meshes[-1], grid, meshes[-2] if len(meshes) > 1 else None) if meshes else em.Mesh.uniform(grid)
        z = equations.vector(start)
        records = newton.newton_iterations(
            equations.residual,
            equations.jacobian,
            z,
            admissible=lambda candidate, equations=equations: not equations.mesh(candidate).is_folded,  # type: ignore[misc]
            tolerance=TIGHT_DEVIATION * equations.mean_flux(z),
            factorise=solver.factorise(grid.shape),
            reuse=solver.reuse,
        )
        *_, last = records
        seconds.append(time.process_time() - begun)
        if last.stalled:
            raise RuntimeError(f"Newton's method with {solver.name} stalls on {grid}")
        steps.append(last.step)
        meshes = [*meshes[-1:], equations.mesh(last.z)]
    return Solved(seconds=seconds, steps=steps, mesh=meshes[-1])


def _coarse(n: int) -> list[em.Grid]:
    return [em.Grid(n_xi=m, n_eta=m) for m in (n // 4 + 1, n // 2 + 1)]
