"""How meshes show themselves: their cells in colours, on the axes of the reader or in a small picture.

Pictures need matplotlib: ``pip install 'equimesh[plot]'``. Nothing here uses pyplot, unless axes are left out.
"""

from __future__ import annotations

import io
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, MeshParts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

STYLE = {
    "svg.hashsalt": "equimesh",
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
}
NO_MATPLOTLIB = "drawing needs matplotlib: pip install 'equimesh[plot]'"
_ONE_AT_A_TIME = threading.Lock()  # matplotlib's settings are the process's while a figure is drawn


@contextmanager
def drawing(width: float, height: float) -> Iterator[Figure]:
    """A figure of ``width`` x ``height`` inches in our style, which the block draws and saves.

    Raises ``ImportError`` without matplotlib.
    """
    try:
        import matplotlib.style
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(NO_MATPLOTLIB) from error
    with _ONE_AT_A_TIME, matplotlib.style.context(["default", STYLE]):
        yield Figure(figsize=(width, height))


# The cells of a mesh in a picture, and their colours.

DECADES = 3.0
"""The scale of colours ends this many powers of ten below the largest error. Smaller errors have its palest colour."""
MIN_DECADES = 1.0
"""The scale of colours spans at least this many powers of ten."""
PALETTE = "YlOrRd"
"""Pale where the error is small, dark red where it is large."""
EDGES = "#00000070"
"""The edges of the cells: where they crowd, the colours below still show."""
UNKNOWN = "#777777"
"""Cells without a finite error."""
MAX_WITH_EDGES = 128
"""Cells in a direction, of a grid or as if blocks were a square, up to which their edges are drawn."""
MAX_VECTOR_CELLS = 80**2
"""More cells than this are drawn as dots in an SVG, too."""


class Drawable(Protocol):
    """A piece of a mesh: it draws its cells in colours, and has the lines of its edges."""

    def draw(self, axes: Axes, **style: Any) -> ScalarMappable:
        """Draw the cells; ``style`` is that of matplotlib's ``pcolormesh``, with a ``norm``."""

    def lines(self) -> list[Array]:
        """The lines of the edges, shape ``(nodes, 2)`` each."""

    @property
    def values(self) -> Array:
        """The values of the cells."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """Cells in rows and columns: nodes of shape ``(n_i, n_j)``, values of the cells of ``(n_i - 1, n_j - 1)``."""

    x: Array
    y: Array
    values: Array

    def draw(self, axes: Axes, **style: Any) -> ScalarMappable:
        """Draw the cells."""
        return axes.pcolormesh(self.x, self.y, self.values, **style)

    def lines(self) -> list[Array]:
        """All lines in both directions."""
        nodes = np.stack([self.x, self.y], axis=-1)
        return [*nodes, *nodes.swapaxes(0, 1)]


@dataclass(frozen=True, kw_only=True, eq=False)
class LoosePiece:
    """Cells without order: ``corners`` of shape ``(m, 4, 2)`` or ``(m, 3, 2)``, ``values`` of ``(m,)``."""

    corners: Array
    values: Array

    def draw(self, axes: Axes, **style: Any) -> ScalarMappable:
        """Draw the cells."""
        from matplotlib.collections import PolyCollection

        cells = PolyCollection([*self.corners], array=self.values, edgecolors="face", linewidths=0.1, **style)
        axes.add_collection(cells)
        return cells

    def lines(self) -> list[Array]:
        """One closed line for each cell."""
        return [*np.concatenate([self.corners, self.corners[:, :1]], axis=1)]


def pieces_of(mesh: Any, values: Array | None = None, otherwise: float = 0.0) -> list[Drawable]:
    """The pieces of a mesh, each with its share of the ``values`` of the cells; all are ``otherwise`` without.

    ``mesh`` has ``blocks``, the nodes of each, and ``points``; or ``x`` and ``y`` of a grid, shape ``(n_xi, n_eta)``;
    or ``points`` and ``cells`` alone. ``values`` have the shape of its cells, and may be masked.
    """
    blocks = _blocks_of(mesh)
    shapes = [(block.shape[0] - 1, block.shape[1] - 1) for block in blocks]
    places = getattr(mesh, "block_cells", None) or _in_order(shapes)
    if len(blocks):
        flat = np.full(sum(map(math.prod, shapes)), otherwise) if values is None else values.ravel()
        nodes = [mesh.points[block] for block in blocks]
        return [Piece(x=at[..., 0], y=at[..., 1], values=flat[cells]) for at, cells in zip(nodes, places, strict=True)]
    if mesh.x.ndim == 2:
        shape = (mesh.x.shape[0] - 1, mesh.x.shape[1] - 1)
        return [
            Piece(x=mesh.x, y=mesh.y, values=np.full(shape, otherwise) if values is None else values.reshape(shape))
        ]
    cells = np.full(len(mesh.cells), otherwise) if values is None else values.ravel()
    return [LoosePiece(corners=mesh.points[mesh.cells], values=cells)]


def _blocks_of(mesh: Any) -> Sequence[Any]:
    """The nodes of each block; empty for a mesh that has none, or does not know them."""
    blocks = getattr(mesh, "blocks", ())
    return [*blocks.values()] if isinstance(blocks, Mapping) else blocks


def _in_order(shapes: Sequence[tuple[int, int]]) -> list[Any]:
    """The numbers of the cells of blocks of these shapes, block by block."""
    ends = np.cumsum([0, *(math.prod(shape) for shape in shapes)])
    return [np.arange(end - math.prod(shape), end).reshape(shape) for shape, end in zip(shapes, ends[1:], strict=True)]


def error_of_cells(mesh: Any, values: Array) -> Array | None:
    """The error of every cell for a picture: of ``values`` at the nodes an estimate, those of the cells themselves.

    The estimate is the leading part of the error of bilinear elements: an eighth of the second differences of the
    values along the lines, without those that the bend of the lines alone causes. ``None`` where the lines are not
    known, or there are fewer than three nodes along one.
    """
    if values.size == len(mesh.cells):
        return abs(values)
    blocks = _blocks_of(mesh) or ([np.arange(mesh.x.size).reshape(mesh.x.shape)] if mesh.x.ndim == 2 else [])
    if values.size != mesh.x.size or not len(blocks) or min(min(block.shape) for block in blocks) < 3:
        return None
    x, y, u = mesh.x.ravel(), mesh.y.ravel(), values.ravel()
    places = getattr(mesh, "block_cells", None) or _in_order([(n - 1, m - 1) for n, m in (at.shape for at in blocks)])
    found = np.full(len(mesh.cells), np.nan)
    for nodes, cells in zip(blocks, places, strict=True):
        found[np.asarray(cells).ravel()] = _interpolation_errors(x[nodes], y[nodes], u[nodes]).ravel()
    return found.reshape(mesh.x.shape[0] - 1, mesh.x.shape[1] - 1) if mesh.x.ndim == 2 else found


def _interpolation_errors(x: Array, y: Array, u: Array) -> Array:
    """The estimate for the cells of one block, from its nodes and the values there."""
    (x_i, x_j), (y_i, y_j), (u_i, u_j) = (np.gradient(one) for one in (x, y, u))
    with np.errstate(all="ignore"):
        det = x_i * y_j - x_j * y_i
        slope = (u_i * y_j - u_j * y_i) / det, (x_i * u_j - x_j * u_i) / det
        nodes = np.zeros_like(u)
        for axis in (0, 1):
            second = [np.diff(np.pad(one, 1, mode="reflect", reflect_type="odd"), 2, axis) for one in (u, x, y)]
            inside = [one[:, 1:-1] if axis == 0 else one[1:-1] for one in second]
            for one in inside:  # a line has no second difference at its ends: that of its neighbours is taken
                moved = np.moveaxis(one, axis, 0)
                moved[0], moved[-1] = moved[1], moved[-2]
            nodes += abs(inside[0] - slope[0] * inside[1] - slope[1] * inside[2]) / 8.0
    mean: Array = 0.25 * (nodes[:-1, :-1] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[1:, 1:])
    return mean


def colours_of(errors: list[Array]) -> LogNorm:
    """The scale of colours: from the largest error down, over ``MIN_DECADES`` to ``DECADES`` powers of ten."""
    from matplotlib.colors import LogNorm

    known = np.concatenate([error[np.isfinite(error) & (error > 0.0)] for error in errors] or [np.zeros(0)])
    if not known.size:
        return LogNorm(10.0**-MIN_DECADES, 1.0)
    largest = float(known.max())
    decades = min(max(math.log10(largest / float(known.min())), MIN_DECADES), DECADES)
    return LogNorm(largest * 10.0**-decades, largest)


def draw_cells(axes: Axes, mesh: Any, error: Array | None, scale: LogNorm) -> ScalarMappable:
    """Draw every cell with the colour of its ``error``, and the lines of a mesh that is not too fine for them."""
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    shown = None if error is None else np.ma.masked_invalid(np.maximum(error, scale.vmin or 0.0))
    pieces = pieces_of(mesh, shown, scale.vmin or 0.0)
    count = sum(piece.values.size for piece in pieces)
    # of blocks as if they were a square of as many cells
    across = max(mesh.x.shape) - 1 if mesh.x.ndim == 2 else math.isqrt(count)
    palette = colormaps[PALETTE].with_extremes(bad=UNKNOWN)
    style = {"cmap": palette, "norm": scale, "rasterized": count > MAX_VECTOR_CELLS}
    drawn = [piece.draw(axes, **style) for piece in pieces]
    if across <= MAX_WITH_EDGES:
        lines = [line for piece in pieces for line in piece.lines()]
        axes.add_collection(LineCollection(lines, colors=EDGES, linewidths=min(0.5, 18 / across)))
    return drawn[0]


# One mesh: on the axes of the reader, and as a small picture for a notebook.

SIDE = 3.2
"""Inches of the longer side of the picture in a notebook."""
RESOLUTIONS = (150, 100, 70, 45)
"""Dots per inch of that picture: the first whose file is small enough."""
MAX_BYTES = 70_000
"""Bytes of the picture, in base64 a third more."""


def draw_on(mesh: Any, error: Array | None = None, axes: Axes | None = None) -> Axes:
    """Draw a mesh on ``axes``, every cell with the colour of its ``error``, and return the axes.

    Without ``axes`` those of pyplot are taken. The colours are even in the logarithm; ``error`` has the shape of the
    cells, and is ``None`` where there is none. Raises ``ImportError`` without matplotlib, and :class:`BadValues` for
    what is no axes, such as the name of a file.
    """
    if axes is None:
        try:
            import matplotlib.pyplot as plt
        except ImportError as missing:
            raise ImportError(NO_MATPLOTLIB) from missing
        axes = plt.gca()
    elif not is_axes(axes):
        remedy = "give axes of matplotlib, or save the picture with .plot().figure.savefig('mesh.png')"
        raise BadValues(f"axes = {axes!r:.40}: {remedy}")
    draw_cells(axes, mesh, error, colours_of([] if error is None else [error]))
    axes.set_aspect("equal")
    axes.autoscale_view()
    return axes


def is_axes(value: object) -> bool:
    """Whether a value is axes of matplotlib."""
    return hasattr(value, "pcolormesh")


def picture(mesh: Any, error: Array | None = None) -> bytes | None:
    """A small PNG of a mesh without a background, as :func:`draw_on` draws it; ``None`` without matplotlib."""
    width, height = float(np.ptp(mesh.x)), float(np.ptp(mesh.y))
    return small_png(lambda axes: draw_on(mesh, error, axes), width, height)


def picture_of_values(mesh: Any, values: Array) -> bytes | None:
    """The :func:`picture` of a mesh with these values, by :func:`error_of_cells`.

    ``None`` for a mesh whose nodes are not here: one of a service, whose client is asyncio's.
    """
    return picture(mesh, error_of_cells(mesh, values)) if hasattr(mesh, "x") else None


def small_png(draw: Callable[[Axes], object], width: float, height: float) -> bytes | None:
    """A PNG of at most ``MAX_BYTES`` of what ``draw`` draws, in the proportions of ``width`` and ``height``."""
    size = SIDE / max(width, height)
    try:
        with drawing(max(size * width, 0.4), max(size * height, 0.4)) as figure:
            axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            draw(axes)
            axes.set_axis_off()
            for resolution in RESOLUTIONS:
                file = io.BytesIO()
                figure.savefig(file, format="png", dpi=resolution, transparent=True)
                if file.tell() <= MAX_BYTES:
                    break
    except ImportError:
        return None
    return file.getvalue()


def facts_of(mesh: MeshParts) -> list[tuple[str, str]]:
    """The rows of a table about a mesh: its points, its cells, its box and its sides."""
    kind = "triangles" if mesh.cells.shape[1] == 3 else "quadrilaterals"
    (x, y), (right, top) = mesh.points.min(axis=0), mesh.points.max(axis=0)
    shape = " x ".join(map(str, mesh.shape)) if mesh.shape else str(len(mesh.points))
    return [
        ("points", shape),
        ("cells", f"{len(mesh.cells)} {kind}"),
        ("box", f"x from {x:.4g} to {right:.4g}, y from {y:.4g} to {top:.4g}"),
        ("sides", ", ".join(mesh.sides)),
    ]
