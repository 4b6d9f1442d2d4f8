"""The loop: solve on a mesh, adapt to the solution, until the estimate stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from numbers import Integral
from typing import Any, Generic, TypedDict, Unpack, overload

from equimesh.adapt.rounds import BlockRounds, Following, GridRounds, Looked, M, Rounds
from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import UNIT_SQUARE, Domain
from equimesh.errors import InputError
from equimesh.least_error.elements import Norm
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.curvature import NORMS
from equimesh.numerics.threads import thread_count
from equimesh_coupling.adaptation import Adaptation, AdaptRound, ended, require_same_kind, verdict_on
from equimesh_coupling.recovery import CellAverages, ErrorIndicator, cell_values
from equimesh_coupling.values import node_values

MAX_ROUNDS = 100
"""The most rounds that can be requested."""
OWN_POINTS = "a domain in blocks has a number of points of its own, by its counts of cells: leave n out"
"""Why a number of points is refused."""


class AdaptArguments(TypedDict, Generic[M], total=False):
    """The other arguments of :func:`adapt`."""

    rounds: int
    norm: Norm
    threads: int | None
    observe: Callable[[AdaptRound[M]], None] | None


@overload
def adapt(
    solve: Callable[[Mesh], Any],
    n: int | tuple[int, int],
    *,
    domain: Domain = UNIT_SQUARE,
    **options: Unpack[AdaptArguments[Mesh]],
) -> Adaptation[Mesh]: ...
@overload
def adapt(
    solve: Callable[[QuadMesh], Any],
    n: None = None,
    *,
    domain: Blocks,
    **options: Unpack[AdaptArguments[QuadMesh]],
) -> Adaptation[QuadMesh]: ...
def adapt(
    solve: Callable[[Any], Any],
    n: int | tuple[int, int] | None = None,
    *,
    domain: Domain | Blocks = UNIT_SQUARE,
    rounds: int = 5,
    norm: Norm = "l2",
    threads: int | None = None,
    observe: Callable[[AdaptRound[Any]], None] | None = None,
) -> Adaptation[Mesh] | Adaptation[QuadMesh]:
    """The mesh of ``n`` points a direction, or ``(n_xi, n_eta)``, that is adapted to the solution of a solver.

    A domain in blocks has a number of points of its own: leave ``n`` out there. The first mesh is its initial one.

    ``solve(mesh)`` solves on an :class:`~equimesh.meshes.mesh.Mesh`, or a
    :class:`~equimesh.meshes.quad_mesh.QuadMesh` of blocks, which has the methods ``to_skfem()``,
    ``to_dolfinx(comm)`` and so on, and returns one of these: values at the nodes, a field of a library with an adaptor,
    :class:`~equimesh_coupling.recovery.CellAverages`, or an :class:`~equimesh_coupling.recovery.ErrorIndicator` of the
    cells. It is called first on the uniform mesh, then at most ``rounds`` times. ``norm`` is that of the error that
    meshes minimise and by which rounds are ranked: ``"l2"`` of u, or ``"h1"`` of its gradient, relative to that on the
    same mesh, since an absolute one favours meshes that do not resolve. ``observe`` is called with every round.

    Raises :class:`~equimesh_coupling.errors.BadValues` where the values of the first solve cannot be used, and what the
    first solve raises. Later the loop ends with the best mesh so far: ``reason`` says why, ``failure`` is the
    exception. Raises :class:`~equimesh.errors.InputError` for arguments that cannot be used.
    """
    if isinstance(domain, Blocks):
        if n is not None:
            raise InputError(f"n = {str(n)[:40]!r}: {OWN_POINTS}", field="n")
        _check(solve, rounds, norm)
        _check_observer(observe)
        on_blocks = BlockRounds(domain=domain, norm=norm, threads=thread_count(threads))
        return _loop(solve, on_blocks, rounds, norm, observe)
    grid, threads = _grid(n), thread_count(threads)
    _check(solve, rounds, norm)
    _check_domain(domain)
    _check_observer(observe)
    return _loop(solve, GridRounds(grid=grid, domain=domain, norm=norm, threads=threads), rounds, norm, observe)


def _loop(
    solve: Callable[[Any], Any],
    by: Rounds[M],
    rounds: int,
    norm: Norm,
    observe: Callable[[AdaptRound[M]], None] | None,
) -> Adaptation[M]:
    """The loop itself, for meshes of any kind."""
    done: list[AdaptRound[M]] = []
    following: Following[M] = by.first
    while True:
        try:
            mesh, moved, start = following()
            # The solver gets its own arrays, which it may change.
            returned = solve(by.copied(mesh))
            record, following = _looked_at(returned, mesh, by)
            require_same_kind(done, is_indicator=isinstance(returned, ErrorIndicator))
        except Exception as failure:
            if not done:
                raise
            return ended(done, rounds, norm, failure)
        done.append(replace(record, number=len(done), moved_cells=moved, start=start))
        if observe is not None:
            observe(done[-1])
        if verdict_on(done, rounds, norm).is_done:
            return ended(done, rounds, norm)


def _looked_at(returned: Any, mesh: M, by: Rounds[M]) -> Looked[M]:
    """The record of what a solver returned, and the way to the next mesh."""
    if isinstance(returned, ErrorIndicator):
        return by.indicated(mesh, cell_values(returned, mesh))
    if isinstance(returned, CellAverages):
        return by.averaged(mesh, node_values(returned, mesh))
    return by.known(mesh, node_values(returned, mesh))


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


def _check_domain(domain: object) -> None:
    """Refuse what is no domain."""
    if not (callable(getattr(domain, "map", None)) and callable(getattr(domain, "jacobian", None))):
        raise InputError(
            f"domain = {str(domain)[:40]!r} is no domain: give one, such as Rectangle(x=(0, 2), y=(0, 1))",
            field="domain",
        )


def _check_observer(observe: object) -> None:
    """Refuse an observer that cannot be called."""
    if observe is not None and not callable(observe):
        raise InputError("observe is no function: give one that takes the record of a round", field="observe")
