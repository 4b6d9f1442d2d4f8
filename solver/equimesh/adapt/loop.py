"""The loop: solve on a mesh, adapt to the solution, until the estimate stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from numbers import Integral
from typing import Any, TypeAlias

import numpy as np

from equimesh.adapt.indicated import indicated_mesh
from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.recovered import reference_on
from equimesh.least_error.elements import Norm
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.curvature import NORMS
from equimesh.numerics.threads import thread_count
from equimesh.numerics.types import Array
from equimesh.rounds.recovery import moved_cells
from equimesh.rounds.round import Knowledge
from equimesh_coupling.adaptation import Adaptation, AdaptRound, ended, require_same_kind, verdict_on
from equimesh_coupling.cells import ErrorIndicator, cell_values
from equimesh_coupling.values import node_values

MAX_ROUNDS = 100
"""The most rounds that can be requested."""


def adapt(
    solve: Callable[[Mesh], Any],
    n: int | tuple[int, int],
    *,
    domain: Domain = UNIT_SQUARE,
    rounds: int = 5,
    norm: Norm = "l2",
    threads: int | None = None,
    observe: Callable[[AdaptRound[Mesh]], None] | None = None,
) -> Adaptation[Mesh]:
    """The mesh of ``n`` points a direction, or ``(n_xi, n_eta)``, that is adapted to the solution of a solver.

    ``solve(mesh)`` solves on an :class:`~equimesh.meshes.mesh.Mesh`, which has the methods ``to_skfem()``,
    ``to_dolfinx(comm)`` and so on, and returns one of these: values at the nodes, a field of a library with an adaptor,
    :class:`~equimesh_coupling.cells.CellAverages`, or an :class:`~equimesh_coupling.cells.ErrorIndicator` of the cells.
    It is called first on the uniform mesh, then at most ``rounds`` times. ``norm`` is that of the error that meshes
    minimise, ``"l2"`` of u or ``"h1"`` of its gradient; the best mesh has the smallest estimate in L2, since
    one in H1 favours meshes that do not resolve. ``observe`` is called with every round.

    Raises :class:`~equimesh_coupling.errors.BadValues` where the values of the first solve cannot be used, and what the
    first solve raises. Later the loop ends with the best mesh so far: ``reason`` says why, ``failure`` is the
    exception. Raises :class:`~equimesh.errors.InputError` for arguments that cannot be used.
    """
    grid, threads = _grid(n), thread_count(threads)
    _check(solve, rounds, norm)
    _check_others(domain, observe)
    done: list[AdaptRound[Mesh]] = []

    def following() -> tuple[Mesh, float, str]:
        return map_mesh(Mesh.uniform(grid), domain), 0.0, "given"

    while True:
        try:
            mesh, moved, start = following()
            # The solver gets its own arrays, which it may change.
            returned = solve(Mesh(mesh.x.copy(), mesh.y.copy()))
            record, following = _looked_at(returned, mesh, domain, norm, threads)
            require_same_kind(done, is_indicator=isinstance(returned, ErrorIndicator))
        except Exception as failure:
            if not done:
                raise
            return ended(done, rounds, failure)
        done.append(replace(record, number=len(done), moved_cells=moved, start=start))
        if observe is not None:
            observe(done[-1])
        if verdict_on(done, rounds).is_done:
            return ended(done, rounds)


Following: TypeAlias = Callable[[], tuple[Mesh, float, str]]
"""The next mesh, how far it moves, and the name of its start."""
Looked: TypeAlias = tuple[AdaptRound[Mesh], Following]
"""The record of what a solver returned, and the way to the next mesh."""


def _looked_at(returned: Any, mesh: Mesh, domain: Domain, norm: Norm, threads: int) -> Looked:
    """The record of what a solver returned, and the way to the next mesh."""
    if isinstance(returned, ErrorIndicator):
        return _indicated(mesh, cell_values(returned, mesh), domain, norm, threads)
    return _known(mesh, node_values(returned, mesh), domain, norm, threads)


def _known(mesh: Mesh, values: Array, domain: Domain, norm: Norm, threads: int) -> Looked:
    """The record of nodal values, and the way to the next mesh."""
    known = Knowledge.of(mesh, values, domain, threads)

    def following() -> tuple[Mesh, float, str]:
        found = known.next_mesh(norm, threads)
        return map_mesh(found.reference, domain), found.moved_cells, found.chosen

    record = AdaptRound(
        number=0,
        mesh=mesh,
        values=values,
        estimate=0.0 if known.is_exact else known.estimate,
        estimate_h1=known.estimate_h1,
        unresolved=known.unresolved,
    )
    return record, following


def _indicated(mesh: Mesh, values: Array, domain: Domain, norm: Norm, threads: int) -> Looked:
    """The record of an error indicator, and the way to the next mesh."""

    def following() -> tuple[Mesh, float, str]:
        found = indicated_mesh(mesh, values, domain, norm, threads)
        return found, moved_cells(reference_on(mesh, domain), reference_on(found, domain)), "weight"

    return AdaptRound(number=0, mesh=mesh, values=values, estimate=float(np.linalg.norm(values))), following


def _grid(n: Any) -> Grid:
    """The grid of a number of points, or of one a direction; raises :class:`~equimesh.errors.InputError`."""
    counts = (n, n) if isinstance(n, Integral) else n
    is_pair = isinstance(counts, tuple | list) and len(counts) == 2
    if not (is_pair and all(isinstance(one, Integral) and not isinstance(one, bool) for one in counts)):
        raise InputError(f"n = {str(n)[:40]!r}: a number of points a direction, or a pair (n_xi, n_eta)", field="n")
    return Grid(n_xi=int(counts[0]), n_eta=int(counts[1]))


def _check(solve: object, rounds: object, norm: object) -> None:
    """Refuse arguments that cannot be used."""
    if not callable(solve):
        raise InputError(
            "solve is no function: give one that takes a mesh and returns the solution on it", field="solve"
        )
    if not isinstance(rounds, int) or isinstance(rounds, bool) or not 1 <= rounds <= MAX_ROUNDS:
        raise InputError(f"rounds = {rounds!r}: a whole number between 1 and {MAX_ROUNDS}", field="rounds")
    if norm not in NORMS:
        raise InputError(f"norm = {norm!r}: choose 'l2' or 'h1'", field="norm")


def _check_others(domain: object, observe: object) -> None:
    """Refuse a domain and an observer that cannot be used."""
    if not (callable(getattr(domain, "map", None)) and callable(getattr(domain, "jacobian", None))):
        raise InputError(
            f"domain = {str(domain)[:40]!r} is no domain: give one, such as Rectangle(x=(0, 2), y=(0, 1))",
            field="domain",
        )
    if observe is not None and not callable(observe):
        raise InputError("observe is no function: give one that takes the record of a round", field="observe")
