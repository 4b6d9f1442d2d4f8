"""Loops over nodal values: the smallest corner Jacobian, which shows whether a mesh is folded, and differences."""

import numpy as np

from equimesh.meshes.parts import Parts
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray


def smallest_in_parts(x: Array, y: Array, parts: Parts) -> float:
    """:func:`smallest_jacobian`, to which every part contributes that of its own cells."""
    return parts.smallest(lambda part: smallest_jacobian(x[part.rows_and_next], y[part.rows_and_next]))


@compiled
def smallest_jacobian(x: Array, y: Array) -> float:
    """The smallest corner Jacobian of a mesh, not scaled by the spacing; NaN where a coordinate is not a number."""
    n_xi, n_eta = x.shape
    # By columns, so that the compiler can use vector instructions. Minima ignore NaN, sums do not.
    smallest, check = np.full(n_eta - 1, np.inf), np.zeros(n_eta - 1)
    for i in range(n_xi - 1):
        x0, x1, y0, y1 = x[i], x[i + 1], y[i], y[i + 1]
        for j in range(n_eta - 1):
            ex0, ey0 = x1[j] - x0[j], y1[j] - y0[j]
            ex1, ey1 = x1[j + 1] - x0[j + 1], y1[j + 1] - y0[j + 1]
            fx0, fy0 = x0[j + 1] - x0[j], y0[j + 1] - y0[j]
            fx1, fy1 = x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            one, two = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
            three, four = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
            here = min(min(one, two), min(three, four))
            smallest[j] = min(smallest[j], here)
            check[j] += one + two + three + four
    return smallest.min() if np.isfinite(check.sum()) else np.nan


@compiled
def largest_difference(one: Array, other: Array) -> float:
    """The largest absolute difference of nodal values; NaN where one is not a number."""
    rows, columns = one.shape
    largest, check = np.zeros(columns), 0.0
    for i in range(rows):
        a, b = one[i], other[i]
        for j in range(columns):
            difference = abs(a[j] - b[j])
            largest[j] = max(largest[j], difference)
            check += difference
    return largest.max() if np.isfinite(check) else np.nan


@compiled
def smallest_of_cells(points: Array, cells: IntArray) -> float:
    """The smallest corner Jacobian of quadrilaterals of any mesh; NaN where a coordinate is not a number."""
    smallest, check = np.inf, 0.0
    for k in range(len(cells)):
        a, b, c, d = cells[k]
        xa, ya, xb, yb = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
        xc, yc, xd, yd = points[c, 0], points[c, 1], points[d, 0], points[d, 1]
        at_a = (xb - xa) * (yd - ya) - (yb - ya) * (xd - xa)
        at_b = (xc - xb) * (ya - yb) - (yc - yb) * (xa - xb)
        at_c = (xd - xc) * (yb - yc) - (yd - yc) * (xb - xc)
        at_d = (xa - xd) * (yc - yd) - (ya - yd) * (xc - xd)
        smallest = min(smallest, min(min(at_a, at_b), min(at_c, at_d)))
        check += at_a + at_b + at_c + at_d
    return smallest if np.isfinite(check) else np.nan
