"""Starts of a descent: straight lines on nested grids, and how a mesh is carried from grid to grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from equimesh.domains.domain import UNIT_SQUARE, Domain, Rectangle, closed_of, map_mesh
from equimesh.fields.expression import Field
from equimesh.least_error.cells import Cells, cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.kernels import Norm
from equimesh.least_error.nest import GridLevel, nested_levels
from equimesh.least_error.objective import Objective
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.nested import Closed, closed_mesh, interpolated_across, interpolated_closed, interpolated_values
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.settings import Schwarz

# Meshes to start from: the uniform one, and the best rectilinear ones.

MAX_PASSES = 8
"""Passes of one-dimensional equidistribution; layers of a thousandth of the domain are found within them."""
MIN_CHANGE_CELLS = 0.05
"""Largest move of a line, in spacings, at which the passes end."""
MAX_CROSSINGS = 33
"""Lines of the other family, at most, over which the mean is taken."""
MORE_ORDERS = {"l2": 3, "h1": 1}
"""What is added to twice the degree: one over it is the power of the integral of the squared derivative."""
INSET_SHARE = 0.1
"""The share of a spacing by which lines are moved from a side where u has no finite slope."""
ENDS = 4
"""Lines of a closed family that are repeated at either end, so that interpolation goes on there."""
BISECTIONS = 60
"""Halvings of the range in which the beginning of a closed family is sought: to rounding."""
ROUNDING_SHARE = 1e-13
"""The share of the largest derivative of u that counts as rounding in a derivative, or in its change."""


class Patch(NamedTuple):
    """A piece of a domain that two families of straight lines cross: a grid, or a block."""

    places: Callable[[Array, Array], Sequence[Array]]
    """``x, y, x_s, x_t, y_s, y_t`` at flat arrays of s and t, the positions of lines from 0 to 1."""
    families: tuple[int, int] = (0, 1)
    """The numbers of the families of lines of constant s, and of constant t."""
    turned: tuple[bool, bool] = (False, False)
    """Whether the positions of the lines of each family run the other way."""
    share: float = 1.0
    """Share of the domain that it covers."""


def equidistributed(
    u: Field,
    patches: Sequence[Patch],
    counts: Sequence[int],
    norm: Norm,
    floor: float,
    closed: Sequence[bool] | None = None,
    degree: int = 1,
) -> list[Array] | None:
    """The positions, 0 to 1, of ``counts`` lines of each family, of a mesh whose lines are straight on every patch.

    Each family is equidistributed in the density of least error of interpolation of a ``degree`` p, for the mean over
    the lines that cross it: the integral of the square of the derivative of order p + 1 to the power 1/(2 p + 3) in
    L2, 1/(2 p + 1) in H1, smoothed over neighbours.
    ``floor`` times its mean is added: more of it leaves more lines where u is flat. The lines of a ``closed`` family
    go on after a turn; their mean position is that of uniform ones, so that it does not matter where they begin.
    ``None`` where u is not finite.
    """
    closed = closed or [False] * len(counts)
    exponent = 1.0 / (2 * degree + MORE_ORDERS[norm])
    lines = [np.linspace(0.0, 1.0, count) for count in counts]
    for _ in range(MAX_PASSES):
        few = [
            resampled(line, min(line.size, MAX_CROSSINGS), closed=is_closed)
            for line, is_closed in zip(lines, closed, strict=True)
        ]
        lengths = [_shares(line, is_closed) for line, is_closed in zip(few, closed, strict=True)]
        found: list[list[tuple[Array, Array]]] = [[] for _ in lines]
        for patch in patches:
            along = _along(u, patch, lines, few)
            if along is None:
                return None
            for axis, slopes in enumerate(along):
                shares = patch.share * lengths[patch.families[1 - axis]]
                found[patch.families[axis]].append((slopes, shares[::-1] if patch.turned[1 - axis] else shares))
        moved = [
            _equidistributed(line, *_together(crossed), (exponent, floor), is_closed, degree)
            for line, crossed, is_closed in zip(lines, found, closed, strict=True)
        ]
        lines = [line for line, _ in moved]
        if max(change for _, change in moved) < MIN_CHANGE_CELLS:
            break
    return lines


def rectilinear(
    u: Field,
    domain: Domain,
    counts: tuple[int, int],
    norm: Norm,
    floor: float,
    *,
    closed: tuple[bool, bool] = (False, False),
    degree: int = 1,
) -> tuple[Array, Array] | None:
    """The positions of ``counts`` lines along s and along t of a grid, as :func:`equidistributed` finds them."""

    is_plain = isinstance(domain, Rectangle) and domain.is_unit_square

    def places(s: Array, t: Array) -> Sequence[Array]:
        if is_plain:
            one, none = np.ones(s.size), np.zeros(s.size)
            return s, t, one, none, none, one
        return *domain.map(s, t), *domain.jacobian(s, t)

    found = equidistributed(u, [Patch(places)], counts, norm, floor, closed, degree)
    return None if found is None else (found[0], found[1])


def _together(crossed: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Slopes along one family, and the shares of the crossings, of several patches."""
    if len(crossed) == 1:
        return crossed[0]
    slopes, shares = zip(*crossed, strict=True)
    return np.concatenate(slopes, axis=1), np.concatenate(shares)


def _along(u: Field, patch: Patch, lines: Sequence[Array], few: Sequence[Array]) -> tuple[Array, Array] | None:
    """The derivatives of u along both families of a patch where ``few`` lines of the other cross: ``(lines, few)``.

    ``None`` where they are not finite.
    """
    (s, few_s), (t, few_t) = (
        [1.0 - at[family][::-1] if is_turned else at[family] for at in (lines, few)]
        for family, is_turned in zip(patch.families, patch.turned, strict=True)
    )
    found = _finite_slopes(u, patch, s, few_t)
    other = found if (s.size, t.size) == (few_s.size, few_t.size) else _finite_slopes(u, patch, few_s, t)
    if found is None or other is None:
        return None
    along_s, along_t = found[0], other[1]
    return -along_s[::-1] if patch.turned[0] else along_s, -along_t[::-1] if patch.turned[1] else along_t


def product(s: Array, t: Array) -> Array:
    """The mesh of straight lines, shape ``(2, nodes)``."""
    mesh = np.empty((2, s.size, t.size))
    mesh[0], mesh[1] = s[:, None], t
    return mesh.reshape(2, -1)


def resampled(line: Array, count: int, *, closed: bool = False) -> Array:
    """The positions of ``count`` lines, by monotone interpolation of those in ``line``; it may be a closed family."""
    if line.size == count:
        return line
    if (line.size - 1) % (count - 1) == 0:
        return line[:: (line.size - 1) // (count - 1)].copy()
    at = np.linspace(0.0, line.size - 1.0, count)
    if line.size == 2:
        return at
    if closed:
        number = np.arange(-ENDS, line.size + ENDS)
        turns, node = np.divmod(number, line.size - 1)
        return np.asarray(scipy.interpolate.PchipInterpolator(number, line[node] + turns)(at))
    return np.asarray(scipy.interpolate.PchipInterpolator(np.arange(line.size), line)(at))


def _shares(line: Array, closed: bool) -> Array:
    """The length that each line stands for, in a mean over the family."""
    steps = line[1:] - line[:-1]
    if closed:
        return np.append(0.5 * (steps + np.roll(steps, 1)), 0.0)
    shares = np.empty(line.size)
    shares[0], shares[-1], shares[1:-1] = steps[0], steps[-1], 0.5 * (line[2:] - line[:-2])
    return shares


def _finite_slopes(u: Field, patch: Patch, s: Array, t: Array) -> tuple[Array, Array] | None:
    """The derivatives of u by s, ``(s, t)``, and by t, ``(t, s)``; ``None`` where they are not finite.

    They are from points next to the sides where they are infinite on these.
    """
    return _slopes(u, patch, s, t) or _slopes(u, patch, _inset(s), _inset(t))


def _inset(line: Array) -> Array:
    """The line with its ends moved inwards by a small share of their spacings."""
    inset = line.copy()
    inset[0] += INSET_SHARE * (line[1] - line[0])
    inset[-1] -= INSET_SHARE * (line[-1] - line[-2])
    return inset


def _slopes(u: Field, patch: Patch, s: Array, t: Array) -> tuple[Array, Array] | None:
    """The derivatives of u by s, ``(s, t)``, and by t, ``(t, s)``, at the crossings of the lines.

    They are 0 where they are nothing but rounding; ``None`` where they are not finite.
    """
    x, y, *jacobian = patch.places(*product(s, t))
    known: Any = tuple(np.ascontiguousarray(part) for part in (*u.evaluate(x, y, order=1)[1:], *jacobian))
    along_s, along_t = np.empty((s.size, t.size)), np.empty((t.size, s.size))
    return (along_s, along_t) if slopes_along(known, along_s, along_t) else None


@compiled
def slopes_along(known: tuple[Array, Array, Array, Array, Array, Array], along_s: Array, along_t: Array) -> bool:
    """Fill in the derivatives by s, ``(s, t)``, and by t, ``(t, s)``; False where one of them is not finite.

    ``known`` are ``u_x, u_y, x_s, x_t, y_s, y_t`` at the flat crossings. Sums that are nothing but rounding are 0.
    """
    u_x, u_y, x_s, x_t, y_s, y_t = known
    largest_s, largest_t, check, k = 0.0, 0.0, 0.0, 0
    for i in range(along_s.shape[0]):
        for j in range(along_s.shape[1]):
            a, b, c, d = u_x[k] * x_s[k], u_y[k] * y_s[k], u_x[k] * x_t[k], u_y[k] * y_t[k]
            largest_s, largest_t = max(largest_s, abs(a), abs(b)), max(largest_t, abs(c), abs(d))
            along_s[i, j], along_t[j, i] = a + b, c + d
            check += 0.0 * along_s[i, j] + 0.0 * along_t[j, i]  # NaN where one is infinite
            k += 1
    for i in range(along_s.shape[0]):
        for j in range(along_s.shape[1]):
            if abs(along_s[i, j]) <= ROUNDING_SHARE * largest_s:
                along_s[i, j] = 0.0
            if abs(along_t[j, i]) <= ROUNDING_SHARE * largest_t:
                along_t[j, i] = 0.0
    return check == 0.0


def _equidistributed(
    line: Array, slopes: Array, shares: Array, wanted: tuple[float, float], closed: bool, degree: int
) -> tuple[Array, float]:
    """The line moved to equal integrals of its density, and its largest move, as :func:`move` tells it.

    Derivatives of order 2 and more are differences of ``slopes``. ``shares`` are the lengths for which the lines of the
    other family stand, ``wanted`` the exponent and the floor of the density.
    """
    for _ in range(degree - 1):
        slopes = np.gradient(slopes, line, axis=0)
    integral, out = np.empty(line.size), np.empty(line.size)
    change = move(line, np.ascontiguousarray(slopes), np.ascontiguousarray(shares), wanted, closed, integral, out)
    if change < 0.0:
        return line, 0.0
    if not closed:
        return out, change
    out = _with_uniform_mean(integral, line)
    steps, moves = np.diff(line), np.abs(out - line)
    return out, float(max(np.max(moves[1:] / steps), np.max(moves[:-1] / steps)))


@compiled
def move(
    line: Array, slopes: Array, shares: Array, wanted: tuple[float, float], closed: bool, integral: Array, out: Array
) -> float:
    """Fill ``integral`` with that of the density from the first line to each, and ``out`` with lines at equal ones.

    The result is the largest move of a line, as a share of the smaller of its spacings; negative where u does not bend.
    Of a closed family only the integral is filled. ``slopes`` of shape ``(lines, crossings)`` are derivatives along the
    family; ``wanted`` are exponent and floor.
    """
    exponent, floor = wanted
    cells, crossings = line.size - 1, shares.size
    largest, size = 0.0, 0.0
    for i in range(cells + 1):
        for k in range(crossings):
            largest = max(largest, abs(slopes[i, k]))
    bends, density = np.zeros((cells, crossings)), np.zeros(cells)
    for i in range(cells):
        for k in range(crossings):
            change = slopes[i + 1, k] - slopes[i, k]
            if abs(change) > ROUNDING_SHARE * largest:
                bends[i, k] = change / (line[i + 1] - line[i])
                size = max(size, abs(bends[i, k]))
    if not size > 0.0:
        return -1.0
    for i in range(cells):
        for k in range(crossings):
            density[i] += (bends[i, k] / size) * (bends[i, k] / size) * shares[k]
        density[i] = density[i] ** exponent
    total = 0.0
    for i in range(cells):  # the mean with the neighbours
        before = density[i - 1] if i > 0 else density[cells - 1 if closed else 0]
        after = density[i + 1] if i < cells - 1 else density[0 if closed else cells - 1]
        integral[i + 1] = 0.25 * before + 0.5 * density[i] + 0.25 * after
        total += integral[i + 1] * (line[i + 1] - line[i])
    integral[0] = 0.0
    for i in range(cells):
        integral[i + 1] = integral[i] + (integral[i + 1] + floor * total) * (line[i + 1] - line[i])
    if closed:
        return 0.0
    step, cell, farthest = integral[cells] / cells, 0, 0.0
    for k in range(1, cells):
        while cell < cells - 1 and integral[cell + 1] <= k * step:
            cell += 1
        steepness = (line[cell + 1] - line[cell]) / (integral[cell + 1] - integral[cell])
        out[k] = steepness * (k * step - integral[cell]) + line[cell]
        share = abs(out[k] - line[k]) / min(line[k + 1] - line[k], line[k] - line[k - 1])
        farthest = max(farthest, share) if np.isfinite(share) else np.inf
    out[0], out[cells] = 0.0, 1.0
    return farthest


def _with_uniform_mean(integral: Array, line: Array) -> Array:
    """A closed family at equal integrals of its density, with the mean position of uniform lines."""
    total, cells = float(integral[-1]), line.size - 1
    knots = np.concatenate([integral[:-1] - total, integral[:-1], integral + total])
    places = np.concatenate([line[:-1] - 1.0, line[:-1], line + 1.0])
    at = np.linspace(0.0, total, line.size)
    low, high = -total, total
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        mean = float(np.interp(at[:-1] + middle, knots, places).mean())
        low, high = (middle, high) if mean < 0.5 * (cells - 1) / cells else (low, middle)
    moved = np.interp(at + low, knots, places)
    moved[-1] = moved[0] + 1.0
    return np.asarray(moved)


OPEN: Closed = (False, False)
"""No lines are closed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """The straight lines ``s`` and ``t`` from which cells are measured and displaced, on grids of any size."""

    name: str
    s: Array
    t: Array
    closed: Closed = OPEN
    """Whether lines along xi, and those along eta, are closed."""
    _starts: dict[Grid, Array] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def uniform(cls, name: str = "uniform", closed: Closed = OPEN) -> Start:
        """From the uniform mesh."""
        ends = np.array([0.0, 1.0])
        return cls(name=name, s=ends, t=ends, closed=closed)

    @classmethod
    def given(cls, mesh: Mesh, closed: Closed = OPEN) -> Start:
        """From a given mesh on its own grid, else from the uniform one."""
        origin = cls.uniform("given", closed)
        origin._starts[mesh.grid] = coordinates_of(mesh)
        return origin

    @property
    def is_uniform(self) -> bool:
        """Whether the first meshes are uniform."""
        return self.s.size == self.t.size == 2

    def first_mesh(self, grid: Grid) -> Array:
        """The first mesh on a grid, shape ``(2, nodes)``."""
        if grid not in self._starts:
            s = resampled(self.s, grid.n_xi, closed=self.closed[0])
            self._starts[grid] = product(s, resampled(self.t, grid.n_eta, closed=self.closed[1]))
        return self._starts[grid]

    def lifted(self, mesh: Array, coarse: Grid, fine: Grid, domain: Domain = UNIT_SQUARE) -> Array:
        """A ``mesh`` on a finer grid: its displacements by cubic, else linear interpolation, else its positions.

        Linear interpolation of positions does not fold where every coarse line is a fine one. The first mesh of the
        grid where all of them fold: in the ``domain`` where lines are closed, else in the reference square.
        """
        if any(self.closed):
            return self._lifted_across(mesh, coarse, fine, domain)
        start, first = self.first_mesh(fine), self.first_mesh(coarse)
        nothing = np.zeros(1)
        for origin, cubic, added in ((first, True, start), (first, False, start), (nothing, False, nothing)):
            parts = (mesh - origin).reshape(2, *coarse.shape)
            moved = [interpolated_values(part, fine.shape, cubic=cubic).reshape(-1) for part in parts]
            lifted = (np.stack(moved) + added).reshape(2, *fine.shape)
            for ends in (lifted[0], lifted[1].T):
                ends[0], ends[-1] = 0.0, 1.0
            flat = lifted.reshape(2, -1)
            if not mesh_of(flat, fine).is_folded:
                return flat
        return start

    def _lifted_across(self, mesh: Array, coarse: Grid, fine: Grid, domain: Domain) -> Array:
        """See :meth:`lifted`, for a mesh with closed lines: displacements and positions go on across its seams."""
        start, first = self.first_mesh(fine), self.first_mesh(coarse)
        parts = (mesh - first).reshape(2, *coarse.shape)
        for cubic in (True, False):
            moved = [interpolated_across(part, fine.shape, self.closed, cubic=cubic).reshape(-1) for part in parts]
            lifted = closed_mesh(mesh_of(np.stack(moved) + start, fine), self.closed)
            if not map_mesh(lifted, domain).is_folded:
                return coordinates_of(lifted)
        lifted = interpolated_closed(mesh_of(mesh, coarse), fine, self.closed, cubic=False)
        return start if map_mesh(lifted, domain).is_folded else coordinates_of(lifted)


@dataclass(frozen=True, kw_only=True)
class GridNest:
    """The nested grids up to ``finest`` on a ``domain``, as a :class:`~equimesh.least_error.nest.Nest`."""

    domain: Domain
    finest: Grid

    @cached_property
    def levels(self) -> list[GridLevel]:
        """The nested grids."""
        return nested_levels(self.finest)

    @property
    def is_regular(self) -> bool:
        """True: lines of a grid run from side to side."""
        return True

    @property
    def is_paved(self) -> bool:
        """False: every grid has coarser ones."""
        return False

    @property
    def finest_cells(self) -> int:
        """Cells of the grid."""
        return self.finest.cells

    @cached_property
    def closed(self) -> Closed:
        """Whether lines along xi, and those along eta, are closed."""
        return closed_of(self.domain)

    def chart(self, level: GridLevel) -> DomainChart:  # noqa: ARG002
        """The map of the domain."""
        return DomainChart(self.domain)

    def cells(self, level: GridLevel, *, are_cut: bool) -> Cells:  # noqa: ARG002
        """The cells of the grid."""
        return cells_of_grid(level.grid.shape, self.closed)

    def initial(self, level: GridLevel) -> Array:
        """The uniform mesh."""
        return coordinates_of(Mesh.uniform(level.grid))

    def first_mesh(self, origin: Start, level: GridLevel) -> Array:
        """The first mesh of a start on this level."""
        return origin.first_mesh(level.grid)

    def uniform(self) -> Start:
        """The start from the uniform mesh."""
        return Start.uniform(closed=self.closed)

    def rectilinear(self, u: Field, norm: Norm, most: int, floor: float, degree: int = 1) -> Start | None:
        """The start from straight lines, at most ``most`` of each family."""
        counts = min(self.finest.n_xi, most), min(self.finest.n_eta, most)
        lines = rectilinear(u, self.domain, counts, norm, floor, closed=self.closed, degree=degree)
        return None if lines is None else Start(name="rectilinear", s=lines[0], t=lines[1], closed=self.closed)

    def given(self, mesh: Mesh) -> Start:
        """The start from a mesh of the finest grid."""
        return Start.given(mesh, self.closed)

    def from_coarse(self, mesh: Mesh) -> Start:  # noqa: ARG002
        """The start that continues from such a mesh on a coarse grid: distortion is that of the uniform mesh."""
        return Start.uniform("given", self.closed)

    def sampled(self, mesh: Mesh, level: GridLevel) -> Array | None:
        """A mesh of the finest grid on a coarser one; ``None`` where it is folded there."""
        if any(self.closed):
            sampled = coordinates_of(interpolated_closed(mesh, level.grid, self.closed))
            return None if self.is_folded(sampled, level) else sampled
        sampled = np.stack([interpolated_values(q, level.grid.shape).reshape(-1) for q in (mesh.x, mesh.y)])
        return None if mesh_of(sampled, level.grid).is_folded else sampled

    def owners(self, settings: Schwarz) -> IntArray:
        """Subdomains are rectangles of cells."""
        return settings.owner_of_cells(self.finest)

    def is_folded(self, mesh: Array, level: GridLevel) -> bool:
        """Whether a mesh is folded on the domain. Few lines around a ring can lie so far apart that their cells are."""
        return any(self.closed) and map_mesh(mesh_of(mesh, level.grid), self.domain).is_folded

    def lifted(
        self,
        origin: Start,
        mesh: Array,
        coarse: GridLevel,
        fine: GridLevel,
        objective: Callable[[], Objective],  # noqa: ARG002
    ) -> Array:
        """A mesh on a finer grid."""
        return origin.lifted(mesh, coarse.grid, fine.grid, self.domain)

    def grid(self, level: GridLevel) -> Grid:
        """The grid of a level."""
        return level.grid

    def mesh(self, level: GridLevel, mesh: Array) -> Mesh:
        """The mesh of the reference square."""
        return mesh_of(mesh, level.grid)

    def min_jacobian(self, level: GridLevel, mesh: Array) -> float:
        """The smallest Jacobian of a corner on the domain, over its area."""
        reference = mesh_of(mesh, level.grid)
        if isinstance(self.domain, Rectangle):  # the same as on the reference square
            return reference.min_jacobian
        return map_mesh(reference, self.domain).min_jacobian / self.domain.area


def mesh_of(mesh: Array, grid: Grid) -> Mesh:
    """The mesh of the reference square with these coordinates, shape ``(2, nodes)``."""
    return Mesh(mesh[0].reshape(grid.shape), mesh[1].reshape(grid.shape))


def coordinates_of(mesh: Mesh) -> Array:
    """The coordinates of a mesh of the reference square, shape ``(2, nodes)``."""
    return np.stack([mesh.x.reshape(-1), mesh.y.reshape(-1)])
