"""The sweeps of one level on a grid of one strip, as one compiled call.

At 65 x 65 nodes the loops of a sweep take a fifth of the time that it takes to call them one by one. Here they are
called by a compiled loop: the kernels, their order and their memory are those of :class:`~equimesh.sweeps.sweep.Sweep`,
and so are all numbers, to the last bit. Where u is a spline of few pieces, it is evaluated inside, and a call makes all
sweeps of a level; otherwise the caller evaluates u, and a call makes one sweep.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.problem import Boundary, Problem
from equimesh.fields.source import Source, fill, nothing, source_of
from equimesh.meshes.mesh import MeshRows, smallest_jacobian
from equimesh.meshes.nested import Rule, common_steps, interpolate, rules
from equimesh.meshes.rows import Rows
from equimesh.numerics.calls import address_of, called_at
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array
from equimesh.sweeps.kernels import (
    Levels,
    Lines,
    Moved,
    Nodes,
    SidePair,
    Strip,
    arc_length_cells,
    arc_length_cells_on,
    end_edges,
    eta_corrections,
    side_moves,
    xi_corrections,
)
from equimesh.sweeps.line_sums import cell_memory, centres, line_levels
from equimesh.sweeps.sweep import MAX_NODES_AT_ONCE, Sides, memory_needed
from equimesh.sweeps.verdict import (
    GO_ON,
    HALVE,
    LOST,
    MIN_JACOBIAN_SHARE,
    MIN_MOVE_SHARE,
    RESIDUAL,
    SMALLEST,
    Rules,
    Swept,
    judge,
)

# Sweeps of one call, at most: each of them keeps its mesh until the call ends.
MAX_SWEEPS_AT_ONCE = 8


class Given(NamedTuple):
    """u times ``factor`` as compiled code evaluates it; where it ``is_given`` not, callers have u.

    ``at_nodes`` has the gradient of u, too, where the mesh is small, and that of the sides is taken from there.
    """

    is_given: bool
    at_nodes: Source
    on_sides: Source
    factor: float

    @classmethod
    def of(cls, metric: ReferenceMetric, points: int) -> Given:
        """u of an arc length on the unit square, if it is a formula, or a spline through samples with few pieces."""
        arc_length = metric.arc_length
        if arc_length is not None and metric.on_unit_square:
            at_nodes, on_sides = (
                source_of(arc_length.u, order) for order in (1 if points <= MAX_NODES_AT_ONCE else 0, 1)
            )
            if at_nodes is not None and on_sides is not None:
                return cls(True, at_nodes, on_sides, metric.factor)
        return cls(False, nothing(), nothing(), 1.0)


class Equidistributed(NamedTuple):
    """The metric: ``a2`` and ``b`` of the arc length, zero for others, and where its cells come from.

    ``on_square`` is an arc length on the unit square, ``by_u`` one on any domain; other metrics are given in the cells.
    ``flat`` sides ignore the normal derivative of u.
    """

    a2: float
    b: float
    on_square: bool
    by_u: bool
    flat: bool


class Coarser(NamedTuple):
    """The coarser solution ``x``, ``y``, and the rules from its grid; every ``steps``-th node is common to both.

    Without common nodes ``steps`` are zero.
    """

    x: Array
    y: Array
    steps: tuple[int, int]
    along_xi: Rule
    along_eta: Rule


class Values(NamedTuple):
    """u and its derivatives at the ``nodes`` of shape ``(3, n)``, and at the nodes of the sides, in two rows each.

    ``side_s``, ``side_t`` are the points of the sides, left and right before bottom and top, ``sides`` of shape
    ``(3, k)`` u there. ``base_eta`` and ``base_xi`` are the pointwise parts of the metric of :class:`SidePair`.
    """

    nodes: Array
    side_s: Array
    side_t: Array
    sides: Array
    base_eta: Array
    base_xi: Array


class Code(NamedTuple):
    """Where the machine code of the kernels is whose sums may be reordered."""

    cells: int
    cells_on: int
    end_edges: int
    along_eta: int
    along_xi: int


class Work(NamedTuple):
    """The working memory of a sweep: ``cells`` of the metric, and what kernels hand to each other."""

    cells: Array
    flux_eta: Array
    flux_xi: Array
    along_eta: Array
    along_xi: Array
    pushes: Array
    first: Array
    sums: Array
    start: Array
    levels: Levels
    lines_eta: Lines
    lines_xi: Lines
    side_eta: Lines
    side_xi: Lines
    largest: Array


def values_for(shape: tuple[int, int]) -> Values:
    """Memory for u on a mesh of the unit square, whose pointwise part is 1."""
    n_xi, n_eta = shape
    bases, sides = (np.zeros((3, 2, n_eta - 1)), np.zeros((3, 2, n_xi - 1))), 2 * (n_xi + n_eta)
    for base in bases:
        base[0] = base[2] = 1.0
    return Values(np.zeros((3, n_xi * n_eta)), np.empty(sides), np.empty(sides), np.zeros((3, sides)), *bases)


def work_for(shape: tuple[int, int]) -> Work:
    """Working memory for a grid whose four sides are physical."""
    n_xi, n_eta = shape
    none_eta, none_xi, corners = np.zeros((2, n_eta)), np.zeros((2, n_xi)), np.zeros((2, 2))
    return Work(
        cells=cell_memory(n_xi - 1, n_eta),
        flux_eta=np.zeros((2, n_eta - 1)),
        flux_xi=np.zeros((2, n_xi - 1)),
        along_eta=np.zeros((2, n_eta)),
        along_xi=np.zeros((2, n_xi)),
        pushes=np.zeros((2, n_eta)),
        first=np.zeros(n_eta),
        sums=np.empty((1, n_eta)),
        start=np.empty((1, n_eta)),
        levels=Levels(np.ones(n_eta), np.zeros(n_eta)),
        lines_eta=Lines(0, n_eta - 1, none_xi, (0.0, 0.0), none_xi),
        lines_xi=Lines(0, n_xi - 1, none_eta, (0.0, 0.0), none_eta),
        side_eta=Lines(0, n_eta - 1, corners, (0.0, 0.0), corners),
        side_xi=Lines(0, n_xi - 1, corners, (0.0, 0.0), corners),
        largest=np.zeros(2),
    )


@cache
def machine_code() -> Code:
    """The addresses of the kernels in this process, for the types of arrays that all sweeps have."""
    work, table = work_for((4, 4)), np.zeros((4, 4))
    nodes, strip = Nodes(table, table), Strip(1, 3, 3)
    out = Moved(table, table, np.zeros((2, 4, 4), dtype=np.float32), table)
    metric = table, table, table, 0.0, 0.0, work.cells
    line = work.first
    return Code(
        cells=address_of(arc_length_cells, *metric),
        cells_on=address_of(arc_length_cells_on, *metric),
        end_edges=address_of(end_edges, table, table, work.cells, 0, line, line, line),
        along_eta=address_of(eta_corrections, nodes, work.cells, strip, work.along_xi, work.lines_eta, out, line),
        along_xi=address_of(xi_corrections, nodes, strip, work.levels, line, out, work.largest),
    )


def is_one_strip(problem: Problem, rows: Rows) -> bool:
    """Whether these are all rows of a grid of one strip, whose sides follow their own equations."""
    return rows.are_all and len(rows.node_strips) == 1 and problem.boundary is not Boundary.ORTHOGONAL


def sweeps_of(
    problem: Problem, nodes: Nodes, memory: Array, coarse: MeshRows | None, rules: Rules, known: Array, most: int
) -> Iterator[Swept]:
    """At most so many sweeps of ``nodes``, until the level is solved, or lost.

    ``memory`` is as of :class:`~equimesh.sweeps.sweep.Sweep`, ``coarse`` the coarser solution. The solution itself is
    in the memory of ``nodes``.
    """
    shape = nodes.x.shape[0], nodes.x.shape[1]
    (x, y), kind, given = nodes, _kind(problem), Given.of(problem.metric, nodes.x.size)
    if not np.isfinite(known[SMALLEST]):
        given = given._replace(is_given=False)  # a polynomial has no place for nodes that are nowhere
    values, work, coarser = values_for(shape), work_for(shape), _coarser(shape, coarse)
    arrays = memory[: memory_needed(shape)].reshape(4, *shape)
    out = Moved(arrays[0], arrays[1], arrays[3].reshape(-1).view(np.float32).reshape(2, *shape), arrays[2])
    at_once = MAX_SWEEPS_AT_ONCE if given.is_given else 1
    code, meshes, made = machine_code(), np.empty((at_once, 2, *shape)), 0
    while made < most:
        records = np.empty((min(at_once, most - made), 4))
        if not given.is_given:
            values = _evaluated(problem, nodes, values, work)
        u = given, values
        verdict, count = sweep_on(code, nodes, out, u, kind, coarser, rules, known, work, meshes, records)
        for k in range(count if verdict == GO_ON else count - 1):
            yield Swept(GO_ON, records[k].tolist(), meshes[k, 0], meshes[k, 1])
        if verdict != GO_ON and count > 0:
            x[:], y[:] = meshes[count - 1]
            yield Swept(verdict, records[count - 1].tolist(), x, y)
        if verdict != GO_ON:
            return
        made += count
        if count % 2 == 1:
            nodes, out = Nodes(out.x, out.y), out._replace(x=nodes.x, y=nodes.y)


def _kind(problem: Problem) -> Equidistributed:
    metric, flat = problem.metric, problem.boundary is Boundary.EQUIDISTRIBUTED_1D
    arc_length = metric.arc_length
    if arc_length is None:
        return Equidistributed(0.0, 0.0, False, False, flat)
    return Equidistributed(arc_length.a**2, arc_length.b, metric.on_unit_square, True, flat)


def _coarser(shape: tuple[int, int], coarse: MeshRows | None) -> Coarser:
    """The coarser solution; where there is none, any arrays, which nobody reads."""
    if coarse is None:
        return Coarser(np.empty((0, 0)), np.empty((0, 0)), (0, 0), *rules((4, 4), (5, 5)))
    steps = common_steps(shape, coarse.rows.shape) or (0, 0)
    return Coarser(coarse.x, coarse.y, steps, *rules(coarse.rows.shape, shape))


def _evaluated(problem: Problem, nodes: Nodes, values: Values, work: Work) -> Values:
    """The values with u at the nodes and on the sides, and the pointwise part of the metric in the cells."""
    metric, (x, y) = problem.metric, nodes
    with np.errstate(all="ignore"):
        place_side_points(nodes, values)
        if metric.arc_length is not None:
            at_once = x.size <= MAX_NODES_AT_ONCE
            found = metric.u_with_gradient(x, y) if at_once else (metric.u(x, y),)
            for row, part in zip(values.nodes, found, strict=False):
                row[:] = part.reshape(-1)
            if not at_once:
                for row, part in zip(values.sides, metric.u_with_gradient(values.side_s, values.side_t), strict=True):
                    row[:] = part
            if metric.on_unit_square:
                return values
        work.cells[0], work.cells[1], work.cells[2] = metric.base(centres(x), centres(y))
        sides, cut = Sides(metric, problem.boundary, (x.shape[0], x.shape[1])), 2 * x.shape[1]
        base_eta, base_xi = sides.bases(values.side_t[:cut].reshape(2, -1), values.side_s[cut:].reshape(2, -1))
        return values._replace(base_eta=base_eta, base_xi=base_xi)


@compiled
def sweep_on(
    code: Code,
    nodes: Nodes,
    out: Moved,
    u: tuple[Given, Values],
    metric: Equidistributed,
    coarser: Coarser,
    rules: Rules,
    known: Array,
    work: Work,
    meshes: Array,
    records: Array,
) -> tuple[int, int]:
    """At most as many sweeps of ``nodes`` as there are ``records``, shape ``(sweeps, 4)``: the verdict, and how many.

    ``meshes`` of shape ``(sweeps, 2, n_xi, n_eta)`` receives the nodes after each sweep. The memory of ``nodes`` and
    ``out`` is exchanged in each sweep; the ``known`` numbers are those of :mod:`equimesh.sweeps.verdict`. A sweep that
    gives no valid mesh is not counted.
    """
    given, values = u
    for count in range(len(records)):
        if given.is_given:
            evaluate_inside(nodes, given, values)
        deviation, move = correct(code, nodes, out, values, metric, work)
        floor = 0.0 if rules.has_coarse else MIN_JACOBIAN_SHARE * known[SMALLEST]
        share, smallest, gap = shorten(nodes, out, known[HALVE] > 0.0, floor, coarser, rules.known and not rules.tight)
        if not (np.isfinite(deviation) and smallest > 0.0):
            return LOST, count
        nodes, out = Nodes(out.x, out.y), Moved(nodes.x, nodes.y, out.along_p, out.squares)
        known[SMALLEST], records[count, RESIDUAL] = smallest, deviation
        keep(nodes, meshes[count])
        verdict = judge(rules, known, move, share, gap, records[count])
        if verdict != GO_ON:
            return verdict, count + 1
    return GO_ON, len(records)


@compiled
def keep(nodes: Nodes, mesh: Array) -> None:
    """Copy the nodes, one by one: for an assignment of arrays Numba compiles many functions for its error message."""
    for i in range(mesh.shape[1]):
        for j in range(mesh.shape[2]):
            mesh[0, i, j], mesh[1, i, j] = nodes.x[i, j], nodes.y[i, j]


@compiled
def place_side_points(nodes: Nodes, values: Values) -> None:
    """The points at which u is needed on the sides."""
    x, y = nodes
    n_xi, n_eta = x.shape
    s, t = values.side_s, values.side_t
    for j in range(n_eta):
        s[j], s[n_eta + j] = 0.0, 1.0
        t[j], t[n_eta + j] = y[0, j], y[n_xi - 1, j]
    cut = 2 * n_eta
    for i in range(n_xi):
        s[cut + i], s[cut + n_xi + i] = x[i, 0], x[i, n_eta - 1]
        t[cut + i], t[cut + n_xi + i] = 0.0, 1.0


@compiled
def evaluate_inside(nodes: Nodes, given: Given, values: Values) -> None:
    """u where a sweep needs it."""
    x, y = nodes.x.reshape(-1), nodes.y.reshape(-1)
    fill(given.at_nodes, x, y, values.nodes)
    if x.size <= MAX_NODES_AT_ONCE:
        scale(values.nodes, given.factor)
        return
    scale(values.nodes[:1], given.factor)
    place_side_points(nodes, values)
    fill(given.on_sides, values.side_s, values.side_t, values.sides)
    scale(values.sides, given.factor)


@compiled
def scale(rows: Array, factor: float) -> None:
    """Multiply all values by ``factor``."""
    for k in range(rows.shape[0]):
        for p in range(rows.shape[1]):
            rows[k, p] *= factor


@compiled
def take_sides_from_nodes(shape: tuple[int, int], values: Values) -> None:
    """u and its derivatives on the sides from those at all nodes."""
    n_xi, n_eta = shape
    cut = 2 * n_eta
    for k in range(3):
        of_nodes, of_sides = values.nodes[k].reshape(n_xi, n_eta), values.sides[k]
        for j in range(n_eta):
            of_sides[j], of_sides[n_eta + j] = of_nodes[0, j], of_nodes[n_xi - 1, j]
        for i in range(n_xi):
            of_sides[cut + i], of_sides[cut + n_xi + i] = of_nodes[i, 0], of_nodes[i, n_eta - 1]


@compiled
def correct(
    code: Code, nodes: Nodes, out: Moved, values: Values, metric: Equidistributed, work: Work
) -> tuple[float, float]:
    """One full correction, as that of :class:`~equimesh.sweeps.sweep.Sweep`: the largest deviation and move."""
    x, y = nodes
    n_xi, n_eta = x.shape
    if x.size <= MAX_NODES_AT_ONCE:
        take_sides_from_nodes((n_xi, n_eta), values)
    deviation, move = correct_sides(nodes, values, metric, work)
    u = values.nodes[0].reshape(n_xi, n_eta)
    if metric.on_square:
        called_at(code.cells, arc_length_cells, (x, y, u, metric.a2, metric.b, work.cells))
    elif metric.by_u:
        called_at(code.cells_on, arc_length_cells_on, (x, y, u, metric.a2, metric.b, work.cells))
    strip, levels, start = Strip(1, n_xi - 1, n_xi - 1), work.levels, work.start[0]
    for end in range(2):
        called_at(
            code.end_edges, end_edges, (x, y, work.cells, -end, work.along_eta[end], work.pushes[end], work.first)
        )
    along_eta = called_at(
        code.along_eta, eta_corrections, (nodes, work.cells, strip, work.along_xi, work.lines_eta, out, work.sums[0])
    )
    first = line_levels(work.first, work.sums[0], work.pushes, work.lines_xi, n_xi - 2, levels, start)
    called_at(code.along_xi, xi_corrections, (nodes, strip, levels, start, out, work.largest))
    place_sides(nodes, out, work)
    if first > deviation:
        deviation = first
    for found in (along_eta, work.largest[0]):
        deviation = max(deviation, found) if np.isfinite(found) else np.inf
    along_xi = work.largest[1] if np.isfinite(work.largest[1]) else np.inf
    move = max(move, along_xi)
    return deviation if np.isfinite(deviation) else np.inf, move if np.isfinite(move) else np.inf


@compiled
def correct_sides(nodes: Nodes, values: Values, metric: Equidistributed, work: Work) -> tuple[float, float]:
    """The moves along the sides: the largest deviation and move."""
    n_xi, n_eta = nodes.x.shape
    cut, strength, both = 2 * n_eta, (metric.a2, metric.b), (True, True)
    place_side_points(nodes, values)
    if metric.flat:
        values.sides[1:] = 0.0
    u, u_s, u_t = values.sides[0], values.sides[1], values.sides[2]
    eta, xi = (2, n_eta), (2, n_xi)
    left = SidePair(values.side_t[:cut].reshape(eta), u[:cut].reshape(eta), u_s[:cut].reshape(eta), values.base_eta)
    bottom = SidePair(values.side_s[cut:].reshape(xi), u[cut:].reshape(xi), u_t[cut:].reshape(xi), values.base_xi)
    one = side_moves(left, strength, both, work.side_eta, work.flux_eta, work.along_eta)
    two = side_moves(bottom, strength, both, work.side_xi, work.flux_xi, work.along_xi)
    deviation = move = 0.0
    for found, largest in (one, two):
        deviation = max(deviation, found) if np.isfinite(found) else np.inf
        if largest > move:
            move = largest
    return deviation, move


@compiled
def place_sides(nodes: Nodes, out: Moved, work: Work) -> None:
    """The new positions of the nodes of the sides."""
    x, y = nodes
    n_xi, n_eta = x.shape
    for end in range(2):
        i = end * (n_xi - 1)
        for j in range(n_eta):
            out.x[i, j], out.y[i, j] = x[i, j], y[i, j] + work.along_eta[end, j]
    for end in range(2):
        j = end * (n_eta - 1)
        for i in range(n_xi):
            out.x[i, j], out.y[i, j] = x[i, j] + work.along_xi[end, i], y[i, j]


@compiled
def shorten(
    nodes: Nodes, out: Moved, halve: bool, floor: float, coarser: Coarser, measured: bool
) -> tuple[float, float, float]:
    """Halve the moves until the smallest Jacobian is above ``floor``, at least once to ``halve``.

    Returns the share that remains, the smallest Jacobian, 0 if halving did not help, and the gap to the coarser
    solution, NaN unless it is ``measured``.
    """
    share, needed, gap = 1.0, halve, np.nan
    while True:
        if needed:
            halve_towards(nodes.x, out.x)
            halve_towards(nodes.y, out.y)
            share *= 0.5
        if measured:
            gap = gap_to(coarser, out)
        smallest = smallest_jacobian(out.x, out.y)
        if smallest > floor:
            return share, smallest, gap
        if 0.5 * share < MIN_MOVE_SHARE:
            return share, 0.0, gap
        needed = True


@compiled
def halve_towards(old: Array, moved: Array) -> None:
    """Halve the moves from ``old`` to ``moved``, in place."""
    for i in range(old.shape[0]):
        for j in range(old.shape[1]):
            moved[i, j] = (moved[i, j] - old[i, j]) * 0.5 + old[i, j]


@compiled
def gap_to(coarser: Coarser, out: Moved) -> float:
    """The largest difference of a coordinate to the coarser solution, at the common nodes if there are any."""
    first, second = coarser.steps
    if first == 0:
        rows = 0, out.x.shape[0]
        in_x = interpolate(coarser.x, coarser.along_xi, coarser.along_eta, rows, out.x, False)
        return max(in_x, interpolate(coarser.y, coarser.along_xi, coarser.along_eta, rows, out.y, False))
    gap = 0.0
    for i in range(coarser.x.shape[0]):
        for j in range(coarser.x.shape[1]):
            k, m = i * first, j * second
            gap = max(gap, abs(out.x[k, m] - coarser.x[i, j]), abs(out.y[k, m] - coarser.y[i, j]))
    return gap
