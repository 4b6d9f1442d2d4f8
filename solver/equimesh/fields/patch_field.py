"""u from values at the nodes of elements of a higher degree, by polynomials of two degrees more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.fields.mesh_map import require_unfolded
from equimesh.fields.nodal_field import COUNT, nodal_values
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import QuadPlaces
from equimesh.meshes.second_order import lattice_of, nodes_of_cells
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh_coupling.elements import element_numbers, lobatto, places_of_cells
from equimesh_coupling.parts import Cells
from equimesh_coupling.recovery import unique_edges

MORE_DEGREES = 2
"""How many degrees more than the elements the polynomials have: with one, estimates on graded meshes were 1.5 times
too large, with two 1.1 times, and for degree 4 2.1 and 1.5 times."""
MIN_PIVOT = 1e-9
"""The least pivot over the largest one of polynomials that the nodes of a patch tell apart."""
BLOCK_CELLS = 256
"""Cells whose polynomials are fitted at once."""


class Patches(NamedTuple):
    """The polynomials of all cells, and the rest of u in each of them."""

    origins: Array
    """The centres of the cells, shape ``(cells, 2)``."""
    scales: Array
    """``a = k0 X``, ``b = k1 X + k2 Y`` are the coordinates of the polynomial, ``(X, Y)`` relative to the centre."""
    fits: Array
    """The coefficients of ``a^k b^j`` in falling order of j, and of k for each j, shape ``(cells, count)``."""
    rests: Array
    """The coefficients of ``s^k t^j`` of the interpolant of the rest, in the same order, ``(cells, p + 1, p + 1)``."""


class Fit(NamedTuple):
    """The polynomials of all cells, and what they leave."""

    patches: Patches
    left: Array
    """The values less the polynomial at the nodes of each cell, in rows along t, shape ``(cells, p + 1, p + 1)``."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class PatchField:
    """u from ``values`` at the nodes of elements of degree p on the cells of a ``mesh``, of a grid or of blocks.

    ``values`` have the shape :func:`~equimesh_coupling.elements.element_shape`. In each cell u is a polynomial of
    degree p + 2 in x and y, fitted to the values in the cells around it, plus the interpolant of degree p of what it
    leaves at the nodes of the cell: it has the values. At the boundary the cells are those around the next cell inside,
    on a grid 3 x 3. Polynomials of degree p + 2 are exact on every mesh, of degree p where one cell alone lies between
    two sides. From cell to cell u jumps by as much as the polynomials differ. A point outside of the mesh has the
    values of the nearest cell; across a periodic join of blocks u goes on.

    Implements :class:`~equimesh.fields.expression.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names
    the first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: Mesh
    values: Array
    left: Array
    """What the polynomials leave at the nodes of each cell, in rows along t, shape ``(cells, p + 1, p + 1)``.

    It is much smaller than the error of the elements where they resolve u, and of its size where they do not.
    """
    _unrolled: Unrolled
    _patches: Patches

    def __init__(self, *, mesh: Mesh, values: npt.ArrayLike, degree: int, cells: Cells = "quad") -> None:
        require_unfolded(mesh)
        nodes = lattice_of(mesh, degree, cells)
        checked = nodal_values(values, nodes).copy()
        unrolled = Unrolled.of(Mesh(mesh.x, mesh.y) if mesh.is_grid else mesh)
        own = np.arange(len(unrolled.search.links.cells)) % unrolled.cells
        numbers = nodes_of_cells(mesh, degree)
        shifts = np.zeros((len(numbers), 2))
        if cells == "triangle":
            shifts = nodes.points[numbers[:, 1, 1]] - mesh.points[mesh.cells].mean(axis=1)
        patches, left = _fitted(unrolled, checked.reshape(-1)[numbers][own], shifts[own])
        found = {"mesh": mesh, "values": checked, "left": left, "_unrolled": unrolled, "_patches": patches}
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        flat = np.ascontiguousarray(x, dtype=float).reshape(-1), np.ascontiguousarray(y, dtype=float).reshape(-1)
        search, rows = self._unrolled.search, np.empty((COUNT[order], flat[0].size))
        evaluate_patches(flat, search.find(*flat), search.corners, self._patches, rows)
        return tuple(row.reshape(x.shape) for row in rows)

    def __repr__(self) -> str:
        return f"PatchField({len(self.mesh.cells)} cells)"


def _around(cells: IntArray, count: int) -> scipy.sparse.csr_array:
    """The cells of the patch of each cell: a row has its columns.

    They are those that share a node with the cell, at the boundary with the nearest cell that has no node there.
    """
    corners = np.repeat(np.arange(len(cells)), 4), cells.ravel()
    of_cells = scipy.sparse.csr_array((np.ones(cells.size, dtype=np.int64), corners), shape=(len(cells), count))
    shared = (of_cells @ of_cells.T).tocsr()
    number = unique_edges(cells)[1]
    outer = np.bincount(number.ravel())[number] == 1
    is_at_boundary = np.zeros(count, dtype=bool)
    is_at_boundary[cells[outer]] = is_at_boundary[np.roll(cells, -1, axis=1)[outer]] = True
    is_inside = ~is_at_boundary[cells].any(axis=1)
    # The one inside that shares most nodes with the cell: the cell itself, one across an edge, or across a corner.
    inside = shared.multiply(is_inside).tocsr()
    inside.eliminate_zeros()
    centres = np.where(np.diff(inside.indptr) > 0, np.asarray(inside.argmax(axis=1)).reshape(-1), np.arange(len(cells)))
    return shared[centres]


def _fitted(unrolled: Unrolled, values: Array, shifts: Array) -> Fit:
    """The polynomials of the cells of the mesh itself, from the values of all cells, ``(cells, p + 1, p + 1)``.

    ``shifts`` lead from the centres of the cells to the middles of their cuts where these are nodes, else they are 0.
    """
    search, degree = unrolled.search, values.shape[1] - 1
    cells, corners = search.links.cells, search.corners
    numbers = element_numbers(cells, len(search.nodes[0]), degree).reshape(len(cells), -1)
    at = places_of_cells(corners, degree)
    at[:, 1, 1] += shifts
    nodal, places = np.empty(numbers.max() + 1), np.empty((numbers.max() + 1, 2))
    nodal[numbers], places[numbers] = (
        values.reshape(numbers.shape),
        at.reshape(*numbers.shape, 2),
    )
    around, centres = _around(cells, len(search.nodes[0])), corners.mean(axis=1)
    to_powers = np.linalg.inv(np.vander(lobatto(degree), increasing=True))
    found: list[list[Array]] = []
    for first in range(0, unrolled.cells, BLOCK_CELLS):
        some = np.arange(first, min(first + BLOCK_CELLS, unrolled.cells))
        nodes, is_there = _nodes_of(around[some], numbers)
        offsets = np.where(is_there[..., None], places[nodes] - centres[some, None], 0.0)
        spread = np.linalg.cholesky(offsets.swapaxes(1, 2) @ offsets / is_there.sum(axis=1)[:, None, None])
        inverse = 0.5 * np.linalg.inv(spread)  # most points are between -1 and 1 then
        monomials = _monomials(offsets @ inverse.swapaxes(1, 2), degree + MORE_DEGREES) * is_there[..., None]
        fit = _solved(monomials, np.where(is_there, nodal[nodes], 0.0)[..., None], degree)
        own = _monomials((places[numbers[some]] - centres[some, None]) @ inverse.swapaxes(1, 2), degree + MORE_DEGREES)
        rest = values[some] - (own @ fit).reshape(values[some].shape)
        scales = np.stack([inverse[:, 0, 0], inverse[:, 1, 0], inverse[:, 1, 1]], axis=1)
        found.append(
            [centres[some], scales, fit[:, :, 0], (to_powers @ rest @ to_powers.T).swapaxes(1, 2)[:, ::-1, ::-1], rest]
        )
    *parts, left = (np.ascontiguousarray(np.concatenate(one)) for one in zip(*found, strict=True))
    return Fit(Patches(*parts), left)


def _solved(monomials: Array, values: Array, degree: int) -> Array:
    """The coefficients that fit the ``values`` best, shape ``(n, count, 1)``.

    One cell between two sides of the mesh has too few nodes across: there the polynomials are of ``degree``.
    """
    fit, is_known = np.zeros((len(monomials), monomials.shape[2], 1)), np.zeros(len(monomials), dtype=bool)
    if monomials.shape[1] >= monomials.shape[2]:
        orthogonal, triangular = np.linalg.qr(monomials)
        pivots = np.abs(np.diagonal(triangular, axis1=1, axis2=2))
        is_known = pivots.min(axis=1) > MIN_PIVOT * pivots.max(axis=1)
        right = orthogonal[is_known].swapaxes(1, 2) @ values[is_known]
        fit[is_known] = np.linalg.solve(triangular[is_known], right)
    if not is_known.all():
        lower = np.array([k + j <= degree for k, j in _powers(degree + MORE_DEGREES)])
        orthogonal, triangular = np.linalg.qr(monomials[~is_known][:, :, lower])
        fit[np.ix_(~is_known, lower)] = np.linalg.solve(triangular, orthogonal.swapaxes(1, 2) @ values[~is_known])
    return fit


def _nodes_of(around: scipy.sparse.csr_array, numbers: IntArray) -> tuple[IntArray, BoolArray]:
    """The nodes of patches, each once, shape ``(n, k)``, and where there are some."""
    counts = np.diff(around.indptr)
    is_there = np.arange(counts.max()) < counts[:, None]
    nodes = np.full((*is_there.shape, numbers.shape[1]), -1)
    nodes[is_there] = numbers[around.indices]
    nodes = np.sort(nodes.reshape(len(counts), -1), axis=1)
    nodes[:, 1:][nodes[:, 1:] == nodes[:, :-1]] = -1
    nodes = -np.sort(-nodes, axis=1)
    nodes = nodes[:, : int((nodes >= 0).sum(axis=1).max())]
    return np.maximum(nodes, 0), nodes >= 0


def _monomials(local: Array, degree: int) -> Array:
    """``a^k b^j`` at places ``(a, b)``, shape ``(n, points, 2)``, in the order of the coefficients."""
    powers = local[..., None] ** np.arange(degree + 1)
    return np.stack([powers[:, :, 0, k] * powers[:, :, 1, j] for k, j in _powers(degree)], axis=-1)


def _powers(degree: int) -> list[tuple[int, int]]:
    """k and j of the monomials, in the order of the coefficients."""
    return [(k, j) for j in range(degree, -1, -1) for k in range(degree - j, -1, -1)]


@compiled
def evaluate_patches(points: Pair, at: QuadPlaces, corners: Array, patches: Patches, rows: Array) -> None:
    """Fill ``rows`` of shape ``(1, 3 or 6, points)`` at points whose cells are known; NaN in no cell."""
    (px, py), (cells, s_in, t_in) = points, at
    origins, scales, fits, rests = patches
    count, size = rows.shape[0], rests.shape[1]
    degree = size - 1 + MORE_DEGREES
    f, w = np.empty(6), np.empty(6)
    for n in range(px.size):
        if cells[n] < 0:
            for row in range(count):
                rows[row, n] = np.nan
            continue
        s, t, c = s_in[n], t_in[n], corners[cells[n]]
        cell = cells[n] % len(origins)  # a copy beyond a join has the polynomial of its original
        left, low = origins[cell, 0], origins[cell, 1]
        if cells[n] != cell:
            left += c[0, 0] - corners[cell, 0, 0]
            low += c[0, 1] - corners[cell, 0, 1]
        k0, k1, k2 = scales[cell, 0], scales[cell, 1], scales[cell, 2]
        a = k0 * (px[n] - left)
        b = k1 * (px[n] - left) + k2 * (py[n] - low)
        evaluate_polynomial(fits[cell], degree + 1, 1, a, b, f)
        evaluate_polynomial(rests[cell].reshape(-1), size, 0, s, t, w)
        rows[0, n] = f[0] + w[0]
        if count == 1:
            continue
        x_s = (1.0 - t) * (c[1, 0] - c[0, 0]) + t * (c[2, 0] - c[3, 0])
        y_s = (1.0 - t) * (c[1, 1] - c[0, 1]) + t * (c[2, 1] - c[3, 1])
        x_t = (1.0 - s) * (c[3, 0] - c[0, 0]) + s * (c[2, 0] - c[1, 0])
        y_t = (1.0 - s) * (c[3, 1] - c[0, 1]) + s * (c[2, 1] - c[1, 1])
        per_det = 1.0 / (x_s * y_t - x_t * y_s)
        s_x, s_y, t_x, t_y = y_t * per_det, -x_t * per_det, -y_s * per_det, x_s * per_det
        w_x, w_y = w[1] * s_x + w[2] * t_x, w[1] * s_y + w[2] * t_y
        rows[1, n], rows[2, n] = f[1] * k0 + f[2] * k1 + w_x, f[2] * k2 + w_y
        if count == 3:
            continue
        x_st, y_st = c[0, 0] - c[1, 0] + c[2, 0] - c[3, 0], c[0, 1] - c[1, 1] + c[2, 1] - c[3, 1]
        ss, st, tt = w[3], w[4] - w_x * x_st - w_y * y_st, w[5]
        rows[3, n] = s_x * (ss * s_x + st * t_x) + t_x * (st * s_x + tt * t_x)
        rows[4, n] = s_x * (ss * s_y + st * t_y) + t_x * (st * s_y + tt * t_y)
        rows[5, n] = s_y * (ss * s_y + st * t_y) + t_y * (st * s_y + tt * t_y)
        rows[3, n] += k0 * (f[3] * k0 + f[4] * k1) + k1 * (f[4] * k0 + f[5] * k1)
        rows[4, n] += (f[4] * k0 + f[5] * k1) * k2
        rows[5, n] += f[5] * k2 * k2


@compiled
def evaluate_polynomial(factors: Array, size: int, fewer: int, a: float, b: float, out: Array) -> None:
    """Fill ``out`` with a polynomial and its first and second derivatives, from the coefficients of ``a^k b^j``.

    They are in falling order of j, from ``size - 1``, and of k for each j. There are ``size - fewer j`` of these.
    """
    f = f_a = f_b = f_aa = f_ab = f_bb = 0.0
    at = 0
    for j in range(size - 1, -1, -1):
        g = g_a = g_aa = 0.0
        for _ in range(size - fewer * j):
            g_aa = g_aa * a + g_a
            g_a = g_a * a + g
            g = g * a + factors[at]
            at += 1
        f_bb = f_bb * b + f_b
        f_b = f_b * b + f
        f = f * b + g
        f_ab = f_ab * b + f_a
        f_a = f_a * b + g_a
        f_aa = f_aa * b + g_aa
    out[0], out[1], out[2], out[3], out[4], out[5] = f, f_a, f_b, 2.0 * f_aa, f_ab, 2.0 * f_bb
