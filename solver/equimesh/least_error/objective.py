"""The function of the node positions that is made small: the error, with a barrier against folds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from equimesh.domains.domain import most_cut_off
from equimesh.fields.expression import Field
from equimesh.fields.source import source_of
from equimesh.least_error import kernels, lagrange
from equimesh.least_error.cells import Cells, Region
from equimesh.least_error.charts import Chart, CurveChart, DomainChart
from equimesh.least_error.evaluation import (
    NO_MATRIX,
    NO_NUMBER,
    OF_SLOPES,
    OF_VALUES,
    OPEN,
    REFUSED,
    Evaluation,
    Parts,
    Result,
    Scales,
    evaluate,
    machine_code,
    memory_for,
)
from equimesh.least_error.kernels import SUMS, NodalValues, Nodes, Rule, Smoothness, Values
from equimesh.least_error.projection import Unknowns, matrix_for
from equimesh.least_error.quasi_newton import RESULTS
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray

MAX_BLOCK_POINTS = 16_384
"""Points at which u is evaluated at once: their arrays stay in the cache."""
NEARBY_SHARE = 1e-3
"""The way from a node to the centre of a cell at which slopes are taken that are infinite at the node."""
BACK_SHARES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7)
"""Shares of the way back to the initial mesh that are tried for a mesh that cuts too much off the domain."""
MAX_SPANS = 7
"""Spans of cells, at most, whose errors compiled code adds: NumPy adds more of them in another order."""
ROUNDING_SHARE = 1e-13
"""The share of the largest value of u below which its error is rounding; of the gradient, times ten over a spacing."""
CUT_OFF_WEIGHT = 30.0
"""The weight of the share of the area that is cut off a domain of blocks, next to the logarithm of the error."""


@dataclass(frozen=True, kw_only=True)
class Weights:
    """The weights of distortion and smoothness in the objective, dimensionless and not negative."""

    distortion: float
    smoothness: float
    obliqueness: float = 0.0
    """The weight of corners whose angles are beyond the limit; 0 for no limit."""
    largest_cotangent: float = math.inf
    """The limit: the largest cotangent of the angle of a corner, and minus the smallest one."""


@dataclass(frozen=True, kw_only=True)
class Sums:
    """What some cells and triples of nodes add to the sums of an objective."""

    square: float
    """Their share of the squared error."""
    every_square: float
    """The squared error of all cells of the objective."""
    distortion: float
    """The sum of ``(r^2 - 1) / 2``."""
    obliqueness: float
    """The sum over the corners whose angles are beyond the limit, without its weight; 0 without a limit."""
    bends: float
    """Half the sum of squared second differences."""
    smallest_share: float
    """The smallest Jacobian of a corner over that of the start, of all cells."""


class Objective:
    """``log |e| + distortion mean((r^2 - 1) / 2) + smoothness sum(b^2) / 2 + 30 c`` of the meshes of a chart.

    ``|e|`` is the norm of the interpolation error. r is the distortion of a corner relative to the mesh ``start``: 1
    for a similar one, unbounded towards a fold. b are the second differences of the displacement from the start along
    lines of nodes. c is the share of the area that is cut off between blocks and their curves, beyond that of the
    initial mesh. The logarithm makes the objective independent of the units of u. Where it is at most that of the
    start, the error is at most that of the start: the other terms are 0 there, and nowhere negative.

    Meshes are arrays of the unknowns of the ``chart``, of shape ``(2, nodes)``.
    """

    def __init__(
        self,
        u: Field,
        chart: Chart,
        cells: Cells,
        start: Array,
        weights: Weights,
        rule: Rule,
        threads: int = 1,
    ) -> None:
        self.cells, self.start = cells, start
        self._u, self._chart, self._weights, self._rule, self._threads = u, chart, weights, rule, threads
        self._first = self.nodes(start)
        self._smooth = Smoothness(cells.triples, weights.smoothness, cells.stiffness, cells.free)
        self._is_plain = isinstance(chart, DomainChart) and chart.is_identity and not cells.ties.size
        self._sums = np.empty((cells.nodes, SUMS))
        self._groups = cells.apart(max(1, MAX_BLOCK_POINTS // rule.points_per_cell))
        self._spans = [span for group in self._groups for span in group]
        self._elements = rule.elements(cells.count)
        self.beyond = 0.0
        """The squared error of further cells that do not change."""
        self.rounding = self._rounding()
        self._initial, self._most_cut_off = start, math.inf
        self._cut_off_weight, self._first_cut_off = 0.0, 0.0

    @property
    def weights(self) -> Weights:
        """The weights of the objective."""
        return self._weights

    def on(self, region: Region) -> Objective:
        """The objective of the whole mesh as a function of the nodes of a region, on one thread.

        Its other nodes are constant. With the squared error of the cells outside in :attr:`beyond`, the two differ by
        the distortion and the bends outside, which are constant, too, and by the term of what is cut off, which only
        the objective of the whole mesh has.
        """
        share = region.cells.count / self.cells.count
        local = Objective(
            self._u,
            self._chart.on(region.nodes),
            region.cells,
            np.ascontiguousarray(self.start[:, region.nodes]),
            replace(
                self._weights,
                distortion=self._weights.distortion * share,
                obliqueness=self._weights.obliqueness * share,
            ),
            self._rule,
        )
        if self._most_cut_off < math.inf:
            local.bound_cut_off(np.ascontiguousarray(self._initial[:, region.nodes]), share)
            local._cut_off_weight = 0.0
        return local

    def bound_cut_off(self, initial: Array, scale: float) -> None:
        """Refuse from now on meshes that cut much more off the curved sides of the domain than ``initial`` does.

        ``scale`` is how many times as many cells the finest mesh has, for whose bound this stands: on fewer cells the
        same map cuts off as many times as much. For a part of the mesh it is its share of the cells.
        """
        self._initial = initial
        self._first_cut_off = self._chart.cut_off(initial, self.cells.sides)
        self._most_cut_off = most_cut_off(self._first_cut_off, scale * self._chart.area)
        if isinstance(self._chart, CurveChart):
            self._cut_off_weight = CUT_OFF_WEIGHT / (scale * self._chart.area)

    @property
    def length(self) -> float:
        """The size of the domain in the units of the unknowns."""
        return self._chart.length

    @cached_property
    def parts(self) -> Parts | None:
        """What compiled code evaluates the objective from; ``None`` where it needs more than that knows."""
        rule, cells, spans = self._rule, self.cells, len(self._spans)
        are_shared = self._threads > 1 and spans > 1
        if not self._is_plain or rule.cells != "quad" or rule.degree > 1 or spans > MAX_SPANS or are_shared:
            return None
        error, unknowns = self._kind_of_error()
        u = source_of(self._u, 1 if error == OF_VALUES else 2)
        if u is None:
            return None
        weights = {name: float(value) for name, value in asdict(self._weights).items()}  # no loop for whole numbers
        element = rule.element
        at_once = cells.count if unknowns is not None else max(last - first for first, last in self._spans)
        return Parts(
            code=machine_code(),
            error=error,
            u=u,
            first=self._first,
            start=self.start,
            elements=self._elements,
            element=element,
            spans=np.array(self._spans, dtype=np.int64),
            smooth=self._smooth,
            scales=Scales(**weights, rounding=self.rounding),
            number=NO_NUMBER if unknowns is None else unknowns.number,
            matrix=NO_MATRIX if unknowns is None else matrix_for(unknowns),
            memory=memory_for(cells.nodes, at_once * element.weights.size, self._sums),
        )

    def _kind_of_error(self) -> tuple[int, Unknowns | None]:
        """The error as compiled code knows it, and what a solver finds."""
        return (OF_SLOPES if self._rule.norm == "h1" else OF_VALUES), None

    def nodes(self, mesh: Array) -> Nodes:
        """The physical nodes of a mesh."""
        return Nodes(*self._chart.nodes(mesh), self.cells.corners.reshape(-1))

    def _rounding(self) -> float:
        """The error that rounding alone can make; infinite where u is not finite at a node of the start."""
        size = float(np.abs(self._u.evaluate(self._first.x, self._first.y)[0]).max())
        noise = ROUNDING_SHARE * size * math.sqrt(self._chart.area)
        if self._rule.norm == "h1":
            noise *= 10.0 * math.sqrt(self.cells.count / self._chart.area)
        return noise if math.isfinite(noise) else math.inf

    def cut(self, mesh: Array) -> bool:
        """From now on measure on the triangles into which ``mesh`` is best cut, if the rule is one for triangles.

        Whether these are others than before.
        """
        if self._rule.cells == "quad":
            return False
        before, cells = self._elements, self.cells
        self._elements = self._rule.elements(cells.count, self.nodes(mesh), cells.corner_cuts)
        return not np.array_equal(before, self._elements)

    @property
    def ties(self) -> IntArray:
        """Pairs of unknowns that move together, a copy and its original: numbers of a flat array, ``(ties, 2)``."""
        ties = self.cells.ties
        return np.concatenate([ties, ties + self.cells.nodes])

    def smallest_share(self, mesh: Array) -> float:
        """The smallest Jacobian of a corner over that of the start; not positive for a folded mesh.

        It is 0 for a mesh that cuts too much off the curved sides of the domain, which is refused as a folded one is.
        """
        if self._cuts_off_much(mesh):
            return 0.0
        return float(kernels.smallest_share(self.nodes(mesh), self._first))

    def _cuts_off_much(self, mesh: Array) -> bool:
        return self._most_cut_off < math.inf and self._chart.cut_off(mesh, self.cells.sides) > self._most_cut_off

    def held(self, mesh: Array) -> Array:
        """The mesh itself, or moved towards the initial one until it cuts little enough off the domain."""
        if not self._cuts_off_much(mesh):
            return mesh
        for share in BACK_SHARES:
            back = mesh - share * (mesh - self._initial)
            if not self._cuts_off_much(back):
                return back
        return self._initial

    def error(self, mesh: Array) -> float:
        """The norm of the interpolation error; infinite where u is not finite, or the cells overlap."""
        square = self._squared_error(self.nodes(mesh))
        return math.sqrt(square) if 0.0 <= square < math.inf else math.inf

    def evaluate(self, mesh: Array, floor: float | None = None) -> Evaluation | None:
        """The objective with its derivatives; ``None`` where a cell is folded, u not finite, or the error rounding.

        With a ``floor`` also where :meth:`smallest_share` is not above it.
        """
        if self.parts is not None:
            gradient, blocks, out = np.empty((2, self.cells.nodes)), np.empty((3, self.cells.nodes)), np.empty(RESULTS)
            least = 0.0 if floor is None else floor
            known = evaluate(self.parts, self.beyond, mesh, least, gradient, blocks, out)
            if known != OPEN:
                found = dict(zip(Result._fields, out.tolist(), strict=True))
                return None if known == REFUSED else Evaluation(**found, gradient=gradient, blocks=blocks)
        return self._evaluated(mesh, floor)

    def _evaluated(self, mesh: Array, floor: float | None) -> Evaluation | None:
        """As :meth:`evaluate`, for all charts, all functions, and slopes that are infinite at nodes."""
        nodes, count = self.nodes(mesh), self.cells.count
        if not kernels.smallest_share(nodes, self._first) > (0.0 if floor is None else floor):
            return None
        cut_off = self._chart.cut_off(mesh, self.cells.sides) if self._most_cut_off < math.inf else 0.0
        if floor is not None and cut_off > self._most_cut_off:
            return None
        square = self._squared_error(nodes) + self.beyond
        if square < 0.0 or not self.rounding < math.sqrt(square) < math.inf:  # folded cells count negative
            return None
        # All sums are scaled by twice the squared error here, and divided by it once they are complete.
        scale = 2.0 * square * self._weights.distortion / (4 * count)
        distortion = self._distortion(nodes, scale) / (4 * count)
        if not math.isfinite(distortion):
            return None
        obliqueness = self._obliqueness(nodes, 2.0 * square / (4 * count)) / (4 * count)
        smoothness, gradient, blocks = self._finished(mesh, 0.5 / square)
        more = self._cut_off_weight * (cut_off - self._first_cut_off)
        if more > 0.0 and isinstance(self._chart, CurveChart):
            self._chart.add_cut_off(mesh, self._cut_off_weight, gradient, blocks)
        value = max(0.0, more) + 0.5 * math.log(square) + self._weights.distortion * distortion + obliqueness
        return Evaluation(
            value=value + self._weights.smoothness * smoothness,
            error=math.sqrt(square),
            distortion=distortion,
            gradient=gradient,
            blocks=blocks,
        )

    def _finished(self, mesh: Array, factor: float) -> tuple[float, Array, Array]:
        """The smoothness, and the derivatives by the unknowns from ``factor`` times the sums of the nodes."""
        cells, smooth = self.cells, self._smooth
        if self._is_plain:
            gradient, blocks = np.empty((2, cells.nodes)), np.empty((3, cells.nodes))
            smoothness = float(kernels.finish(mesh, self.start, self._sums, factor, smooth, gradient, blocks))
            return smoothness, gradient, blocks
        collected, bends = np.empty((SUMS, cells.nodes)), np.zeros_like(mesh)
        kernels.collect(self._sums, factor, collected)
        moves = self._chart.moves(mesh, self.start)
        smoothness = sum(float(kernels.bends(moves[k], cells.triples, bends[k])) for k in (0, 1))
        bend = smooth.weight
        gradient, blocks = self._chart.derivatives(mesh, collected, bend * bends, bend * cells.stiffness)
        cells.restrict(gradient, blocks)
        return smoothness, gradient, blocks

    def sums(self, mesh: Array, cells: int, triples: int) -> Sums:
        """What the first ``cells`` and ``triples`` add to the sums of the objective; infinite where one is folded."""
        nodes = self.nodes(mesh)
        smallest = self.smallest_share(mesh)
        if not smallest > 0.0:
            sums = dict.fromkeys(("square", "every_square", "distortion", "obliqueness", "bends"), math.inf)
            return Sums(**sums, smallest_share=smallest)
        ends = sorted({cells, *(first for first, _ in self._spans), self.cells.count})
        spans = list(pairwise(ends))
        squares = self._squared_errors(nodes, [[span] for span in spans])
        moves, unused = self._chart.moves(mesh, self.start), np.zeros_like(mesh)
        limit, oblique = self._weights.largest_cotangent, 0.0
        if self._weights.obliqueness > 0.0:
            oblique = float(kernels.oblique_corners(nodes, (0, cells), limit, 0.0, self._sums))
        return Sums(
            square=float(squares[: ends.index(cells)].sum()),
            every_square=float(squares.sum()),
            distortion=float(kernels.distortions(nodes, self._first, (0, cells), 0.0, self._sums)),
            obliqueness=oblique,
            bends=sum(float(kernels.bends(moves[k], self.cells.triples[:triples], unused[k])) for k in (0, 1)),
            smallest_share=smallest,
        )

    def _squared_error(self, nodes: Nodes) -> float:
        """The square of the error, with its sums of the nodes in place of all others."""
        if len(self._spans) > 1:
            return float(self._squared_errors(nodes, self._groups).sum())
        nodal, at = self._at_once(nodes)
        self._sums.fill(0.0)
        return self._squared_error_at(nodes, nodal, self._spans[0], at) if self._has_slopes(nodes, nodal) else math.inf

    def _at_once(self, nodes: Nodes) -> tuple[NodalValues, list[Array]]:
        """u at the nodes, and in all cells: fields that search their points begin where those of the last call were."""
        split, values = nodes.x.size, self._values(nodes, (0, self.cells.count), nodes.x.size)
        return NodalValues(*(part[:split].copy() for part in values[:3])), [part[split:] for part in values]

    def _squared_errors(self, nodes: Nodes, groups: list[list[tuple[int, int]]]) -> Array:
        """The squares of the errors of spans of cells, with their sums of the nodes in place of all others.

        Spans of a group have no common node.
        """
        nodal = np.empty((3, nodes.x.size))
        parts = [(first, first + MAX_BLOCK_POINTS) for first in range(0, nodes.x.size, MAX_BLOCK_POINTS)]

        def evaluate(part: tuple[int, int]) -> float:
            here = slice(*part)
            nodal[:, here] = self._u.evaluate(nodes.x[here], nodes.y[here], order=1)
            self._sums[here] = 0.0
            return 0.0

        self._each([parts], evaluate)
        if not self._has_slopes(nodes, NodalValues(*nodal)):
            return np.full(sum(len(group) for group in groups), math.inf)
        return self._each(groups, lambda span: self._squared_error_of(nodes, NodalValues(*nodal), span))

    def _has_slopes(self, nodes: Nodes, nodal: NodalValues, u: Field | None = None) -> bool:
        """Whether ``u`` is finite at all nodes. Slopes that are infinite at a node become those nearby.

        Such a node is a corner or on a side where u is like the square root of the distance, and cannot leave it.
        """
        total = float(nodal.u.sum())
        if not math.isfinite(total):
            return False
        if math.isfinite(total + float(nodal.u_x.sum()) + float(nodal.u_y.sum())):
            return True
        bad = np.flatnonzero(~np.isfinite(nodal.u_x + nodal.u_y))
        if bad.size:
            cells = self.cells.places[self.cells.starts[bad]] // 4
            x, y = (
                (1.0 - NEARBY_SHARE) * q[bad] + NEARBY_SHARE * q[self.cells.corners[cells]].mean(axis=1)
                for q in (nodes.x, nodes.y)
            )
            _, nodal.u_x[bad], nodal.u_y[bad] = (u or self._u).evaluate(x, y, order=1)
        return True

    def _squared_error_of(self, nodes: Nodes, nodal: NodalValues, span: tuple[int, int]) -> float:
        """The squared error of a span of cells."""
        return self._squared_error_at(nodes, nodal, span, self._values(nodes, span))

    def _values(self, nodes: Nodes, span: tuple[int, int], first: int = 0) -> list[Array]:
        """u with its derivatives at the ``first`` nodes, at the points of a span of cells, and at nodes inside them."""
        rule, elements = self._rule, self._elements_of(span)
        count, inner = elements.shape[0], rule.inner_places if rule.degree > 1 else np.empty((0, elements.shape[1]))
        middle = first + count * rule.element.weights.size
        x, y = np.empty(middle + count * len(inner)), np.empty(middle + count * len(inner))
        x[:first], y[:first] = nodes.x[:first], nodes.y[:first]
        kernels.place_points(nodes, elements, rule.element.shape, first, x, y)
        kernels.place_points(nodes, elements, inner, middle, x, y)
        return list(self._u.evaluate(x, y, order=self._order))

    @property
    def _order(self) -> int:
        """The order of the derivatives of u that are needed."""
        return 2 if self._rule.norm == "h1" else 1

    def _elements_of(self, span: tuple[int, int]) -> IntArray:
        per_cell = self._elements.shape[0] // self.cells.count
        return self._elements[per_cell * span[0] : per_cell * span[1]]

    def _squared_error_at(self, nodes: Nodes, nodal: NodalValues, span: tuple[int, int], values: list[Array]) -> float:
        """The squared error of a span of cells with these :meth:`_values`."""
        elements, points = self._elements_of(span), self._rule.element.weights.size
        count, end = elements.shape[0], elements.shape[0] * points
        at = [part[:end].reshape(points, count) for part in values]
        inside = [part[end:].reshape(-1, count) for part in values[:3]] if self._rule.degree > 1 else None
        if not self._has_inner_slopes(nodes, inside, elements):
            return math.inf
        square, check = self._integrated(nodes, elements, span, nodal, inside, at)
        return square if math.isfinite(check) else math.inf

    def _integrated(
        self,
        nodes: Nodes,
        elements: IntArray,
        span: tuple[int, int],
        nodal: NodalValues,
        inside: list[Array] | None,
        at: list[Array],
    ) -> tuple[float, float]:
        """The squared error of a span of cells, and a number that is finite if u is, from u at nodes and points."""
        rule, sums = self._rule, self._sums
        element, of_slopes = rule.element, rule.norm == "h1"
        if inside is not None:
            known = element, rule.basis, nodal, NodalValues(*inside)
            if of_slopes:
                return lagrange.slope_errors(nodes, elements, *known, Values(*at), sums)
            if rule.cells == "quad" and rule.degree == 2:
                of_cells = nodes, span, element, rule.basis.value
                return lagrange.biquadratic_value_errors(*of_cells, *known[2:], NodalValues(*at), sums)
            return lagrange.value_errors(nodes, elements, *known, NodalValues(*at), sums)
        if of_slopes:
            return kernels.slope_errors(nodes, elements, element, nodal, Values(*at), sums)
        if rule.cells == "quad":
            return kernels.quad_value_errors(nodes, span, element, nodal, NodalValues(*at), sums)
        return kernels.value_errors(nodes, elements, element, nodal, NodalValues(*at), sums)

    def _has_inner_slopes(self, nodes: Nodes, inside: list[Array] | None, elements: IntArray) -> bool:
        """Whether u is finite at the nodes inside elements, if there are some; infinite slopes are mended."""
        if inside is None:
            return True
        if not math.isfinite(float(inside[0].sum())):
            return False
        if not math.isfinite(float(inside[1].sum() + inside[2].sum())):
            self._mend_slopes(nodes, NodalValues(*inside), elements)
        return True

    def _mend_slopes(self, nodes: Nodes, inside: NodalValues, elements: IntArray) -> None:
        """Slopes that are infinite at nodes inside elements, or on edges of these, become those nearby."""
        node, cell = np.nonzero(~np.isfinite(inside.u_x + inside.u_y))
        corners, weights = nodes.corners[elements[cell]], self._rule.inner_places[node]
        weights = (1.0 - NEARBY_SHARE) * weights + NEARBY_SHARE / weights.shape[1]
        x, y = ((weights * q[corners]).sum(axis=1) for q in (nodes.x, nodes.y))
        _, inside.u_x[node, cell], inside.u_y[node, cell] = self._u.evaluate(x, y, order=1)

    def _distortion(self, nodes: Nodes, weight: float) -> float:
        """The sum of the distortions over all corners; adds ``weight`` times its derivatives."""
        start, sums = self._first, self._sums
        parts = self._each(self._groups, lambda span: kernels.distortions(nodes, start, span, weight, sums))
        return float(parts.sum())

    def _obliqueness(self, nodes: Nodes, weight: float) -> float:
        """The weighted sum over corners beyond the limit of angles; adds ``weight`` times its derivatives."""
        own, limit = self._weights.obliqueness, self._weights.largest_cotangent
        if own == 0.0:
            return 0.0

        def part(span: tuple[int, int]) -> float:
            return float(kernels.oblique_corners(nodes, span, limit, own * weight, self._sums))

        return own * float(self._each(self._groups, part).sum())

    def _each(self, groups: list[list[tuple[int, int]]], part: Callable[[tuple[int, int]], float]) -> Array:
        """``part`` of every span, group by group, those of one group on threads; no sum depends on their number."""
        return np.concatenate([self._each_of(group, part) for group in groups])

    def _each_of(self, spans: list[tuple[int, int]], part: Callable[[tuple[int, int]], float]) -> Array:
        """``part`` of every span, on threads."""
        sums, threads = np.zeros(len(spans)), min(self._threads, len(spans))

        def work(worker: int) -> None:
            for k in range(worker, len(spans), threads):
                sums[k] = part(spans[k])

        run_on_threads(threads, work)
        return sums
