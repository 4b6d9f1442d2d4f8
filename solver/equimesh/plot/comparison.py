"""A picture of the uniform mesh next to the adapted one, both coloured by the error of each cell."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.plot.block_lines import colour_cells, drawn_lines
from equimesh.plot.figure import figure_file
from equimesh.plot.mesh_lines import MeshLines
from equimesh.quality.comparison import ComparedMesh, UniformComparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

MAX_CELLS_WITH_EDGES = 128
"""Cells in a direction, of a grid or of a block, up to which their edges are drawn."""
MAX_VECTOR_CELLS = 80**2
"""More cells than this are drawn as dots in an SVG, too."""
DECADES = 3.0
"""The scale of colours ends this many powers of ten below the largest error. Smaller errors have its palest colour."""
MIN_DECADES = 1.0
"""The scale of colours spans at least this many powers of ten."""
STACKED_FROM = 1.5
"""Two meshes are drawn one below the other where the width of the domain over its height is larger than this."""
WIDTH = 7.0
"""Width of the picture in inches."""
MAX_SIDE = 4.6
"""A mesh is at most this many inches high."""
GAP = 0.3
"""Inches between the meshes and around them."""
BELOW = 1.35
"""Inches for the scale of colours, and for the words below it."""
PALETTE = "YlOrRd"
"""Pale where the error is small, dark red where it is large."""
EDGES = "#00000070"
"""The edges of the cells: where they crowd, the colours below still show."""
UNKNOWN = "#777777"
"""Cells without a finite error."""
SAME = 1.005
"""A gain is called equal where neither it nor its inverse is larger than this."""


def draw_comparison(comparison: UniformComparison, path: str | Path) -> None:
    """Draw the uniform mesh next to the adapted one, and below them how many times smaller the error is.

    For blocks the mesh that they began with takes the place of the uniform one.

    Every cell has the colour of its interpolation error, the root mean square of ``u - u_h`` in the unit of u. The
    colours are even in the logarithm, and the same for both meshes. Cells without a finite error, those of a folded
    mesh, are grey. Where there is no u, the cells have no colours. ``comparison`` is that of
    :attr:`equimesh.Solution.against_uniform`; ``path`` ends in ``.png`` or ``.svg``.
    """
    meshes = (comparison.uniform, comparison.adapted)
    x, y = comparison.uniform.mesh.x, comparison.uniform.mesh.y
    width, height = float(np.ptp(x)), float(np.ptp(y))
    first = "initial" if isinstance(comparison.uniform.mesh, QuadMesh) else "uniform"
    stacked = width > STACKED_FROM * height
    rows, columns = (2, 1) if stacked else (1, 2)
    side = min((WIDTH / columns - GAP) * height / width, MAX_SIDE)
    with figure_file(path, WIDTH, rows * (side + GAP) + BELOW) as figure:
        panels = figure.subplots(rows, columns)
        scale = _scale([compared.error for compared in meshes if compared.error is not None])
        for axes, compared, name in zip(panels, meshes, (first, "adapted"), strict=True):
            drawn = _draw_cells(axes, compared, scale)
            axes.set_title(name, fontsize=15)
            axes.set_aspect("equal")
            axes.set_axis_off()
        if comparison.interpolation is not None:
            bar = figure.colorbar(drawn, ax=panels, location="bottom", fraction=0.06, aspect=45, pad=0.02)
            bar.set_label("interpolation error of u in the cell", fontsize=12)
            bar.outline.set_visible(False)
        figure.supxlabel(words(comparison), fontsize=15, weight="bold")


def words(comparison: UniformComparison) -> str:
    """The gain in words, as below the picture: "error 13.1 times smaller, with the same 33 × 33 points"."""
    points = "{} points".format(" × ".join(map(str, comparison.adapted.mesh.node_shape)))
    gain = comparison.gain
    if comparison.interpolation is None:
        return f"No u is given, so there is no error to compare ({points})"
    if gain is None:
        return f"The mesh is folded, and has no error ({points})"
    if max(gain, 1.0 / gain if gain > 0.0 else math.inf) <= SAME:
        return f"the same error, with the same {points}"
    if gain > 1.0:
        return f"error {gain:.3g} times smaller, with the same {points}"
    return f"error {1.0 / gain:.3g} times larger, with the same {points}"


def _scale(errors: list[Array]) -> LogNorm:
    """From the largest error down, over at most ``DECADES`` and at least ``MIN_DECADES`` powers of ten."""
    from matplotlib.colors import LogNorm

    known = np.concatenate([error[np.isfinite(error) & (error > 0.0)] for error in errors] or [np.zeros(0)])
    if not known.size:
        return LogNorm(10.0**-MIN_DECADES, 1.0)
    largest = float(known.max())
    decades = min(max(math.log10(largest / float(known.min())), MIN_DECADES), DECADES)
    return LogNorm(largest * 10.0**-decades, largest)


def _draw_cells(axes: Axes, compared: ComparedMesh, scale: LogNorm) -> ScalarMappable:
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    mesh, shape = compared.mesh, _lines_across(compared.mesh)
    error = np.zeros(mesh.cell_shape) if compared.error is None else compared.error
    drawn = colour_cells(
        axes,
        mesh,
        np.ma.masked_invalid(np.maximum(error, scale.vmin or 0.0)),
        cmap=colormaps[PALETTE].with_extremes(bad=UNKNOWN),
        norm=scale,
        rasterized=error.size > MAX_VECTOR_CELLS,
    )
    if shape <= MAX_CELLS_WITH_EDGES:
        axes.add_collection(LineCollection(_lines(mesh), colors=EDGES, linewidths=min(0.5, 18 / shape)))
    return drawn


def _lines_across(mesh: Mesh | QuadMesh) -> int:
    """The cells in a direction of a grid, the larger number; of blocks as if they were a square of as many cells."""
    return math.isqrt(len(mesh.cells)) if isinstance(mesh, QuadMesh) else max(mesh.cell_shape)


def _lines(mesh: Mesh | QuadMesh) -> list[Array]:
    if isinstance(mesh, QuadMesh):
        return drawn_lines(mesh, most=len(mesh.cells))[0]
    lines = MeshLines.of(mesh, most=MAX_CELLS_WITH_EDGES)
    return lines.polylines(*lines.owners(np.zeros(mesh.cell_shape, dtype=np.int64), None), 0)
