"""The common part of two convex cells: its area and its first moments."""

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array

# Corners, at most, of the common part of two quadrilaterals.
MAX_CORNERS = 8


@compiled
def clip_cell(quad: Array, sides: Array, polygon: Array, spare: Array) -> int:
    """Cut the convex quadrilateral ``quad``, shape (4, 2), with another one, ``sides``; both counter-clockwise.

    Returns the number of corners of the common part, which are in ``polygon`` afterwards, shape (MAX_CORNERS + 1, 2) or
    more. It is 0 where the two do not meet. ``spare`` has the shape of ``polygon``.
    """
    count = 4
    for k in range(4):
        polygon[k, 0], polygon[k, 1] = quad[k, 0], quad[k, 1]
    for k in range(4):
        count = clip_half_plane(polygon, count, sides[k], sides[(k + 1) % 4], spare)
        if count < 3:
            return 0
        for m in range(count):
            polygon[m, 0], polygon[m, 1] = spare[m, 0], spare[m, 1]
    return count


@compiled
def clip_half_plane(polygon: Array, count: int, begin: Array, end: Array, kept: Array) -> int:
    """Keep what lies on the left of a line. Returns the number of corners of ``kept`` (Sutherland and Hodgman)."""
    ex, ey = end[0] - begin[0], end[1] - begin[1]
    x0, y0 = polygon[count - 1, 0], polygon[count - 1, 1]
    d0, found = ex * (y0 - begin[1]) - ey * (x0 - begin[0]), 0
    for m in range(count):
        x1, y1 = polygon[m, 0], polygon[m, 1]
        d1 = ex * (y1 - begin[1]) - ey * (x1 - begin[0])
        if (d0 < 0.0) != (d1 < 0.0):
            share = d0 / (d0 - d1)
            kept[found, 0], kept[found, 1] = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
            found += 1
        if d1 >= 0.0:
            kept[found, 0], kept[found, 1] = x1, y1
            found += 1
        x0, y0, d0 = x1, y1, d1
    return found


@compiled
def moments(polygon: Array, count: int, cx: float, cy: float) -> tuple[float, float, float]:
    """The area of a convex polygon, and the integrals of x - cx and of y - cy over it."""
    area = of_x = of_y = 0.0
    x0, y0 = polygon[0, 0], polygon[0, 1]
    for m in range(1, count - 1):
        ax, ay = polygon[m, 0] - x0, polygon[m, 1] - y0
        bx, by = polygon[m + 1, 0] - x0, polygon[m + 1, 1] - y0
        triangle = 0.5 * (ax * by - ay * bx)
        area += triangle
        of_x += triangle * (x0 - cx + (ax + bx) / 3.0)
        of_y += triangle * (y0 - cy + (ay + by) / 3.0)
    return area, of_x, of_y
