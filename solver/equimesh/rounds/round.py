"""One round: from the nodal values of a solver on a mesh to the next mesh, of a grid or of blocks."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import UNIT_SQUARE, Domain
from equimesh.errors import InputError
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import DescentEnd, LeastErrorSolve
from equimesh.least_error.kernels import Norm
from equimesh.least_error.nest import coarse_level
from equimesh.least_error.starts import mesh_of
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.second_order import ValueDegree, require_degree
from equimesh.monitors.least_error import NOT_EARLIER, LeastError
from equimesh.monitors.metrics import NORMS
from equimesh.numerics.threads import thread_count
from equimesh.quality.elements import CellKind
from equimesh.rounds.candidates import PARTS, SHARP, SMOOTH, Search, rule_of
from equimesh.rounds.estimate import EarlierValues, ErrorEstimate
from equimesh.rounds.next_mesh import KEPT, NextMesh, Round, moved_cells
from equimesh.rounds.norms import measured
from equimesh.rounds.recovery import Recovery, on_domain
from equimesh.rounds.shape import ShapeSearch, on_grid

# The candidates for the next mesh of a domain in blocks.

T = TypeVar("T")


class CoarseSolve(LeastErrorSolve):
    """A solve on the coarse grid, to compare weights. Sharper weights get no more steps than others."""

    @property
    def effort(self) -> float:
        """The factor on the number of steps: always 1."""
        return 1.0


WHOLE = "whole"
"""The name of the descent from the initial mesh of the domain."""
REST_CELLS = 1e-9
"""Moves that are nothing but rounding: a service answers with the initial mesh of blocks to the last digit."""


def descents(
    known: Recovery, domain: Blocks, norm: Norm, threads: int, *, of_solver: bool = False
) -> Iterator[tuple[str, Mesh]]:
    """The valid meshes with their names, for the better one of two pairs of weights; ``of_solver`` as of a search."""
    tried: list[Any] = []
    purpose: Any = "finite_element" if of_solver and norm == "l2" and known.degree == 1 else "interpolation"
    before: Any = known.mesh
    for distortion, smoothness in (SMOOTH, SHARP):
        monitor = LeastError(
            u=known.u,
            norm=norm,
            distortion=distortion,
            smoothness=smoothness,
            degree=known.degree,
            cells=known.cells,
            purpose=purpose,
        ).on(domain)
        trial = CoarseSolve(monitor=monitor, domain=domain, threads=threads)
        reached = _end_of(trial.coarse(coarse_level(trial.levels)))
        tried.append((trial.lifted_error(reached), monitor, reached))
    _, monitor, reached = min(tried, key=lambda one: one[0])
    solve = LeastErrorSolve(monitor=monitor, domain=domain, threads=threads)
    is_other = not np.array_equal(before.cells, domain.mesh.cells)
    is_first = is_other or moved_cells(domain.mesh, before) < REST_CELLS
    starts: list[tuple[str, Mesh | None, DescentEnd | None]] = [(WHOLE, None, reached)]
    if not is_first:
        starts.append((PARTS, before, None))
    for name, start, coarse in starts:
        last: Descent | None = None
        for record in solve.steps(start, coarse=coarse):
            last = record
        mesh: Any = coarse.record.mesh if last is None and coarse is not None else None if last is None else last.mesh
        if mesh is not None and not mesh.is_folded_on(threads):
            yield name, mesh


def _end_of(steps: Generator[object, None, T]) -> T:
    """The return value of a descent, whose steps are not used."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found


def next_mesh(known: ErrorEstimate, norm: Norm, threads: int = 1, of: Grid | Blocks | None = None) -> NextMesh:
    """The next mesh: the best candidate in ``norm``, or the same mesh where u is interpolated exactly.

    On blocks it is the best one in L2 where the values do not resolve the solution: a descent on the error of the
    gradient stays near the mesh of the values there. Candidates are descents from the mesh of the values, on a grid
    also meshes of straight lines, on blocks descents from the initial mesh of the domain. The mesh is one ``of``
    another grid, or of blocks with other counts, where that is given; the same one where these have more points.
    """
    before, domain = known.recovery.mesh, known.recovery.domain
    reference = before
    if isinstance(of, Grid) and of.points < before.x.size:
        reference = on_grid(before, of)
    if isinstance(of, Blocks) and of.layout.node_count < before.x.size:
        reference = of.mesh
    kept = NextMesh(reference=reference, chosen=KEPT, norm=norm, candidates={}, gain=1.0, moved_cells=0.0)
    if known.is_exact:
        return kept
    of_solver = known.is_for_solver and norm == "l2"
    if isinstance(domain, Blocks):
        norm = norm if known.is_resolved else "l2"
        kept = replace(kept, norm=norm)
        blocks = of if isinstance(of, Blocks) else domain
        return _best_of_blocks(known.wanted(norm), blocks, norm, threads, of_solver) or kept
    grid = of if isinstance(of, Grid) else before.grid
    return _best_of_grid(known.wanted(norm), norm, threads, grid, of_solver) or kept


def _best_of_blocks(known: Recovery, domain: Blocks, norm: Norm, threads: int, of_solver: bool) -> NextMesh | None:
    rule = rule_of(norm, known.degree, known.cells)

    def error(mesh: Mesh) -> float:
        return measured(known.u, domain, mesh, rule, threads, of_solver=of_solver)

    found = dict(descents(known, domain, norm, threads, of_solver=of_solver))
    errors = {name: error(mesh) for name, mesh in found.items()}
    errors = {name: error for name, error in errors.items() if np.isfinite(error)}
    if not errors:
        return None
    chosen = min(errors, key=lambda name: errors[name])
    least, mesh = errors[chosen], found[chosen]
    return NextMesh(
        reference=mesh,
        chosen=chosen,
        norm=norm,
        candidates=errors,
        gain=error(known.mesh) / least if least > 0.0 else 1.0,
        moved_cells=moved_cells(known.mesh if np.array_equal(known.mesh.cells, mesh.cells) else domain.mesh, mesh),
    )


def _best_of_grid(known: Recovery, norm: Norm, threads: int, grid: Grid, of_solver: bool) -> NextMesh | None:
    before = on_grid(known.mesh, grid)
    domain: Any = known.domain
    search = Search(
        u=known.u,
        domain=domain,
        before=before,
        norm=norm,
        degree=known.degree,
        cells=known.cells,
        of_solver=of_solver,
        threads=threads,
    )
    found = list(search.candidates())
    if not found:
        return None
    best = search.finished(min(found, key=lambda one: one.error))
    square = mesh_of(best.mesh, before.grid)
    reference = Mesh.of_unit_square(square.x, square.y)
    return NextMesh(
        reference=reference,
        chosen=best.name,
        norm=norm,
        candidates={one.name: one.error for one in found},
        gain=search.error_on(known.mesh) / best.error if best.error > 0.0 else 1.0,
        moved_cells=moved_cells(before, reference),
    )


NO_SHAPE_OF_GOALS = "counts are chosen for a norm of the error, not for that of a functional: leave points out"
"""Why a number of points is refused with an adjoint."""


def _are_of_a_mesh(earlier: object, mesh: Mesh) -> bool:
    """Whether they are finite values at the nodes of a mesh of the same kind that is not folded."""
    if not isinstance(earlier, EarlierValues) or earlier.mesh.is_grid != mesh.is_grid or earlier.mesh.is_folded:
        return False
    values = np.asarray(earlier.values)
    is_real = values.dtype.kind in "biuf" and values.shape == earlier.mesh.node_shape
    return is_real and bool(np.isfinite(values).all())


def adapt_round(
    mesh: Mesh,
    values: npt.ArrayLike,
    domain: Domain | Blocks = UNIT_SQUARE,
    norm: Norm = "l2",
    threads: int = 1,
    *,
    degree: ValueDegree = 1,
    adjoint: npt.ArrayLike | None = None,
    earlier: EarlierValues | None = None,
    cells: CellKind = "quad",
    points: int | None = None,
) -> Round:
    """The next mesh for a solution that is known by ``values`` at the nodes of elements of a ``degree`` on ``mesh``.

    ``values`` have the shape :func:`~equimesh.meshes.second_order.nodes_of_elements`: of degree 1 ``mesh.node_shape``,
    of degree p on a grid ``(p (n_xi - 1) + 1, p (n_eta - 1) + 1)``. With ``cells="triangle"``, of degree 1 or 2, the
    elements are the triangles that ``mesh.triangles()`` cuts the mesh into: the middle of each cut stands in place of
    the centre of its cell, see :func:`~equimesh_coupling.elements.element_points`. ``mesh`` is one of ``domain``, of
    any kind. u is recovered from the values as in :class:`~equimesh.fields.nodal_field.HermiteField`, on blocks as in
    :class:`~equimesh.fields.quad_field.QuadField`, for degree 2 with fitted slopes, for degrees 3 and 4 as in
    :class:`~equimesh.fields.patch_field.PatchField`, and as limited cubics between their nodes where the values do not
    resolve u. The next mesh has the smallest measured error in ``norm`` among descents from ``mesh`` and meshes of
    straight lines, on blocks from the initial mesh of the domain: of its interpolant, in L2 of degree 1 that of a
    solver for the equation of Poisson where the values resolve u, or where on ``mesh`` it exceeds that of the
    interpolant. Values of an ``earlier`` solve, on another mesh that resolved u, tell another equation: where they are
    nearer to the u of now than to its projection, the interpolant counts alone, in the estimate, too. With the values
    of an ``adjoint`` at the same nodes, of degree 1, the error is that of its functional: the sum over the cells of the
    products of both errors of the gradient. With ``points`` the mesh has at most so many, and, once the values resolve
    u, the counts of cells along xi and eta, on blocks along classes of edges, that a coarse mesh of least error needs.

    A pure function: equal arguments give an equal mesh bit by bit, for any number of ``threads``. It takes 110 to 140
    microseconds of processor time a point of a rectangle.

    Raises :class:`~equimesh.errors.SamplesError` for values of another shape or not finite, and
    :class:`~equimesh.errors.InputError` for a folded mesh, a mesh and a domain of two kinds, another norm, degree or
    number of threads, and earlier values that are not those of a mesh.
    """
    if norm not in NORMS:
        raise InputError(f"norm = {norm!r}: choose 'l2' or 'h1'", field="norm")
    if earlier is not None and not _are_of_a_mesh(earlier, mesh):
        raise InputError(NOT_EARLIER, field="earlier")
    threads = thread_count(threads)
    known = ErrorEstimate.of(mesh, values, domain, threads, require_degree(degree, cells), adjoint, earlier, cells)
    if points is not None and adjoint is not None:
        raise InputError(NO_SHAPE_OF_GOALS, field="points")
    of = None if points is None else ShapeSearch.within(points, domain).next(known, norm, threads)
    found = next_mesh(known, norm if adjoint is None else "h1", threads, of)
    return Round(
        mesh=mesh if found.reference is known.recovery.mesh else on_domain(found.reference, domain),
        reference=found.reference,
        estimate=0.0 if known.is_exact else known.estimate,
        estimate_h1=known.estimate_h1,
        unresolved=known.unresolved,
        chosen=found.chosen,
        norm=found.norm,
        candidates=found.candidates,
        gain=found.gain,
        moved_cells=found.moved_cells,
        products=known.products,
    )
