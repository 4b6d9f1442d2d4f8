"""Pictures of meshes, of their quality, and of two meshes next to each other.

Needs matplotlib: ``pip install 'equimesh[plot]'``. Every function draws one file and nothing else: no window,
no pyplot, no setting that outlives the call. Equal data give equal files.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.numerics.types import Array, IntArray
from equimesh.plot.figure import (
    SHARED_OWNER,
    MeshLines,
    block_lines,
    colour_cells,
    drawn_lines,
    figure_file,
    outlines,
    owners_of_blocks,
    remark_on,
    step_of,
)
from equimesh.quality.comparison import UniformComparison
from equimesh.schwarz.decomposition import Decomposition
from equimesh_coupling.display import colours_of, draw_cells

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# A picture of the uniform mesh next to the adapted one, both coloured by the error of each cell.

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
SAME = 1.005
"""A gain is called equal where neither it nor its inverse is larger than this."""


def draw_comparison(comparison: UniformComparison, path: str | Path) -> None:
    """Draw the uniform mesh next to the adapted one, and below them how many times smaller the error is.

    For blocks the mesh that they began with takes the place of the uniform one.

    Every cell has the colour of its interpolation error, the root mean square of ``u - u_h`` in the unit of u. The
    colours are even in the logarithm, and the same for both meshes. Cells without a finite error, those of a folded
    mesh, are grey. Where there is no u, or all errors are rounding, the cells
    have no colours. ``comparison`` is that of
    :attr:`equimesh.Solution.against_uniform`; ``path`` ends in ``.png`` or ``.svg``.
    """
    meshes = (comparison.uniform, comparison.adapted)
    x, y = comparison.uniform.mesh.x, comparison.uniform.mesh.y
    width, height = float(np.ptp(x)), float(np.ptp(y))
    first = comparison.uniform.mesh.compared_with
    stacked = width > STACKED_FROM * height
    rows, columns = (2, 1) if stacked else (1, 2)
    side = min((WIDTH / columns - GAP) * height / width, MAX_SIDE)
    with figure_file(path, WIDTH, rows * (side + GAP) + BELOW) as figure:
        panels = figure.subplots(rows, columns)
        errors = [None if comparison.is_exact else compared.error for compared in meshes]
        scale = colours_of([error for error in errors if error is not None])
        for axes, compared, error, name in zip(panels, meshes, errors, (first, "adapted"), strict=True):
            drawn = draw_cells(axes, compared.mesh, error, scale)
            axes.set_title(name, fontsize=15)
            axes.set_aspect("equal")
            axes.set_axis_off()
        if errors[0] is not None:
            bar = figure.colorbar(drawn, ax=panels, location="bottom", fraction=0.06, aspect=45, pad=0.02)
            bar.set_label("interpolation error of u in the cell", fontsize=12)
            bar.outline.set_visible(False)
        figure.supxlabel(words(comparison), fontsize=12, weight="bold")


def words(comparison: UniformComparison) -> str:
    """The gain in words, below the picture: "interpolation error 13.1 times smaller, with the same 33 × 33 points"."""
    points = "{} points".format(" × ".join(map(str, comparison.adapted.mesh.node_shape)))
    gain = comparison.gain
    if comparison.interpolation is None:
        return f"No u is given, so there is no error to compare ({points})"
    if gain is None:
        return f"The mesh is folded, and has no error ({points})"
    if comparison.is_exact:
        return f"u is interpolated exactly on both meshes, to rounding ({points})"
    if max(gain, 1.0 / gain if gain > 0.0 else math.inf) <= SAME:
        return f"the same interpolation error, with the same {points}"
    if gain > 1.0:
        return f"interpolation error {gain:.3g} times smaller, with the same {points}"
    return f"interpolation error {1.0 / gain:.3g} times larger, with the same {points}"


MAX_LINES = 200
"""A mesh with more lines than this in a direction is drawn by every k-th line, as its title states."""
MAX_SURFACE_LINES = 80
"""The surface in three dimensions is drawn by every k-th line beyond this number."""
MAX_CELLS_WITH_EDGES = 80
"""Cells in a direction up to which the picture of a measure shows their edges."""
MAX_LABELS = 12
"""A legend of subdomains has at most this many entries; of more, the title gives the number."""
SQUARE_INCHES = 5.0
"""The side of a square mesh in a figure of the usual size."""
SUBDOMAIN_COLOURS = ("#d62728", "#1f4fd8", "#009e73", "#e69f00", "#56b4e9", "#7f5539")
"""Red and blue as in the paper, then colours that stay apart for colour-blind eyes."""
OVERLAP_COLOUR = "#8e24aa"
SINGLE_COLOUR = "#22577a"
OUTLINE_COLOUR = "#111111"


def draw_mesh(
    data: MeshData,
    path: str | Path,
    *,
    decomposition: Decomposition | None = None,
    show_subdomains: bool = True,
) -> None:
    """Draw the lines of the mesh to ``path``, ``.png`` or ``.svg``.

    With a ``decomposition`` every subdomain has its colour, the first red and the second blue, and what they
    share is purple, as in the 18 x 18 mesh of Haynes and Howse. Without one, the colours show which subdomain
    the cells were taken from. ``show_subdomains=False`` draws all lines in one colour. Of a mesh of blocks, the edges
    of the blocks are drawn thicker.
    """
    of_cell = data.subdomain if show_subdomains else np.zeros_like(data.subdomain)
    if not data.mesh.is_grid:
        pieces, remark, across = _lines_of_blocks(data.mesh, of_cell)
    else:
        pieces, remark, across = _lines_of_grid(data.mesh, of_cell, decomposition if show_subdomains else None)
    owners = sorted(pieces, key=lambda owner: (owner == SHARED_OWNER, owner))
    with figure_file(path, *_inches(data.mesh, 6.0, 6.4, least=(4.0, 1.8))) as figure:
        from matplotlib.collections import LineCollection

        axes = figure.add_subplot()
        width = min(1.2, max(0.3, 36 / across))
        for owner in owners:  # the overlap last, on top
            if len(owners) == 1:
                colour, label = SINGLE_COLOUR, "mesh"
            elif owner == SHARED_OWNER:
                colour, label = OVERLAP_COLOUR, "overlap"
            else:
                colour, label = SUBDOMAIN_COLOURS[owner % len(SUBDOMAIN_COLOURS)], _name(data.mesh, owner)
            axes.add_collection(LineCollection(pieces[owner], colors=colour, linewidths=width, label=label))
        if not data.mesh.is_grid:
            axes.add_collection(LineCollection(outlines(data.mesh), colors=OUTLINE_COLOUR, linewidths=2.0 * width))
        _physical_plane(axes, data.mesh)
        many = (
            f", {len([owner for owner in owners if owner != SHARED_OWNER])} subdomains"
            if len(owners) > MAX_LABELS
            else ""
        )
        axes.set_title(f"Mesh of {_size(data.mesh)}{many}{remark}")
        if 1 < len(owners) <= MAX_LABELS:
            legend = figure.legend(loc="outside lower center", ncols=3 if len(owners) in (3, 5, 6, 9) else 4)
            for handle in legend.get_lines():
                handle.set_linewidth(2.0)


def _lines_of_grid(
    mesh: Mesh, of_cell: IntArray, decomposition: Decomposition | None
) -> tuple[dict[int, list[Array]], str, float]:
    """The lines of every subdomain, what the title says of lines that are left out, and the lines across the mesh."""
    lines = MeshLines.of(mesh, most=MAX_LINES, decomposition=decomposition)
    edges = lines.owners(of_cell, decomposition)
    pieces = {owner: lines.polylines(*edges, owner) for owner in np.union1d(*edges).tolist()}
    return pieces, lines.remark, max(lines.x.shape)


def _lines_of_blocks(mesh: Mesh, of_cell: IntArray) -> tuple[dict[int, list[Array]], str, float]:
    """The lines of a mesh of blocks by subdomain; all belong to one where a block has several."""
    owners = owners_of_blocks(mesh, of_cell)
    if not owners:
        pieces, step = drawn_lines(mesh, MAX_LINES)
        return {0: pieces}, remark_on(step), math.sqrt(len(mesh.points)) / step
    step = step_of(mesh, MAX_LINES)
    found: dict[int, list[Array]] = {}
    for block, owner in enumerate(owners):
        found.setdefault(owner, []).extend(block_lines(mesh, block, step))
    return found, remark_on(step), math.sqrt(len(mesh.points)) / step


def draw_decomposition(decomposition: Decomposition, path: str | Path) -> None:
    """Draw the overlapping subdomains in the computational plane, with the lines of the grid.

    The ends of the overlaps are marked on the axes: between two strips alpha and beta of Haynes and Howse, Figure 1.
    """
    grid, parts = decomposition.grid, decomposition.parts
    with figure_file(path, 6.0, 6.2) as figure:
        from matplotlib.colors import to_rgb

        colours, covered = np.zeros((grid.n_eta - 1, grid.n_xi - 1, 3)), np.zeros((grid.n_eta - 1, grid.n_xi - 1))
        for part in parts:
            cells = tuple(slice(span.first, span.last) for span in part.spans[::-1])
            colours[cells] = to_rgb(SUBDOMAIN_COLOURS[part.number % len(SUBDOMAIN_COLOURS)])
            covered[cells] += 1
        colours[covered > 1] = to_rgb(OVERLAP_COLOUR)
        axes = figure.add_subplot()
        axes.imshow(1 - 0.4 * (1 - colours), origin="lower", extent=(0, 1, 0, 1), interpolation="nearest")
        places = [np.linspace(0, 1, n) for n in grid.shape]
        axes.vlines(places[0], 0, 1, colors="#00000040", linewidths=0.5)
        axes.hlines(places[1], 0, 1, colors="#00000040", linewidths=0.5)
        for part in parts if len(parts) <= MAX_LABELS else ():
            x, y = (
                (place[span.owned_first] + place[span.owned_last]) / 2
                for place, span in zip(places, part.spans, strict=True)
            )
            axes.text(x, y, rf"$\Omega_{{{part.number + 1}}}$", fontsize=20, ha="center", va="center")
        for axis, place, spans in zip((axes.xaxis, axes.yaxis), places, decomposition.spans, strict=True):
            ends = sorted({end for span in spans for end in (span.first, span.last)})
            names = ["", "$\\alpha$\n", "$\\beta$\n", ""] if len(spans) == 2 else [""] * len(ends)
            fractions = ["0", *(f"{end}/{place.size - 1}" for end in ends[1:-1]), "1"]
            axis.set_ticks(place[ends], [name + value for name, value in zip(names, fractions, strict=True)])
        axes.set(xlabel=r"$\xi$", ylabel=r"$\eta$")
        size = f"{grid.n_xi} × {grid.n_eta} points"
        axes.set_title(f"{len(parts)} subdomains of {size}, {decomposition.overlap} points of overlap")
        axes.spines[:].set_visible(False)


def draw_quality(data: MeshData, path: str | Path) -> None:
    """Draw ``Q_eq`` of every cell as a colour: white is equidistributed, orange too small, purple too large.

    The colours are even in the logarithm. Cells without a finite value, those of a folded mesh, are grey.
    """
    mesh, q = data.mesh, np.ma.masked_invalid(np.where(data.q_eq > 0, data.q_eq, np.nan))
    unknown = q.size - int(q.count())
    spread = 1.02 if unknown == q.size else max(1.02, float(np.exp(np.abs(np.log(q.compressed())).max())))
    with figure_file(path, *_inches(mesh, 6.6, 5.8, least=(5.4, 3.4))) as figure:
        from matplotlib import colormaps
        from matplotlib.collections import LineCollection
        from matplotlib.colors import LogNorm
        from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

        axes = figure.add_subplot()
        coloured = colour_cells(
            axes,
            mesh,
            q,
            cmap=colormaps["PuOr"].with_extremes(bad="#777777"),
            norm=LogNorm(1 / spread, spread),
            rasterized=q.size > MAX_CELLS_WITH_EDGES**2,
        )
        pieces = drawn_lines(mesh, MAX_CELLS_WITH_EDGES)[0] if q.size <= MAX_CELLS_WITH_EDGES**2 else []
        axes.add_collection(LineCollection(pieces, colors="#00000066", linewidths=0.5))
        _physical_plane(axes, mesh)
        bar = figure.colorbar(coloured, ax=axes, shrink=0.85, label="$Q_{eq}$ of the cell (1: equidistributed)")
        bar.ax.yaxis.set_major_locator(FixedLocator(np.geomspace(1 / spread, spread, 9).tolist()))
        bar.ax.yaxis.set_minor_locator(NullLocator())
        bar.ax.yaxis.set_major_formatter(FormatStrFormatter("%.2f"))
        largest = "" if unknown == q.size else f", largest $Q_{{eq}}$ {q.compressed().max():.4f}"
        remark = f"\n({unknown} cells without a finite value in grey)" if unknown else ""
        axes.set_title(f"Mesh of {_size(mesh)}{largest}{remark}")


def draw_surface(data: MeshData, path: str | Path) -> None:
    """Draw u over the mesh as a surface in three dimensions, with the mesh lines on it; flat where there is no u."""
    if not data.mesh.is_grid:
        _draw_triangles(data, data.mesh, path)
        return
    lines = MeshLines.of(data.mesh, most=MAX_SURFACE_LINES)
    u = np.zeros_like(lines.x) if data.u is None else data.u[np.ix_(lines.columns, lines.rows)]
    with figure_file(path, 7.0, 5.8) as figure:
        axes: Any = figure.add_subplot(projection="3d")
        width = min(0.5, 20 / max(u.shape))
        axes.plot_surface(
            lines.x, lines.y, u, rstride=1, cstride=1, cmap="viridis", edgecolor="#000000aa", linewidth=width
        )
        axes.view_init(elev=30, azim=-50)
        axes.set(xlabel="$x$", ylabel="$y$", zlabel="$u$")
        axes.set_title(f"u on the mesh of {_size(data.mesh)}{lines.remark}")


def _draw_triangles(data: MeshData, mesh: Mesh, path: str | Path) -> None:
    """The surface over a mesh of blocks, from the triangles of its cells."""
    u = np.zeros(mesh.node_shape) if data.u is None else data.u
    with figure_file(path, 7.0, 5.8) as figure:
        axes: Any = figure.add_subplot(projection="3d")
        width = min(0.5, 20 / math.sqrt(len(u)))
        axes.plot_trisurf(
            mesh.x, mesh.y, u, triangles=mesh.triangles(), cmap="viridis", edgecolor="#000000aa", linewidth=width
        )
        axes.view_init(elev=30, azim=-50)
        axes.set(xlabel="$x$", ylabel="$y$", zlabel="$u$")
        axes.set_title(f"u on the mesh of {_size(mesh)}")


def _name(mesh: Mesh, owner: int) -> str:
    """The name of a block in the legend, or the number of a subdomain."""
    if not mesh.is_grid and owner < len(mesh.block_names):
        return mesh.block_names[owner]
    return f"subdomain {owner + 1}"


def _size(mesh: Mesh) -> str:
    return f"{' × '.join(map(str, mesh.node_shape))} points"


def _inches(mesh: Mesh, width: float, height: float, *, least: tuple[float, float]) -> tuple[float, float]:
    """The size of a figure around a mesh that is not square, where one of a square mesh has ``width`` and ``height``.

    It has the ``least`` size, with room for titles and legends.
    """
    (left, right), (low, high) = _ends(mesh.x), _ends(mesh.y)
    shorter, longer = sorted((right - left, high - low))
    saved = SQUARE_INCHES * (1.0 - shorter / longer) if longer > 0.0 else 0.0
    if right - left < high - low:
        return max(width - saved, least[0]), height
    return width, max(height - saved, least[1])


def _ends(values: Array) -> tuple[float, float]:
    """The smallest and the largest of the values that are finite."""
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)


def _physical_plane(axes: Axes, mesh: Mesh) -> None:
    """Equal scales, and limits that leave the mesh a narrow margin."""
    for set_limits, values in ((axes.set_xlim, mesh.x), (axes.set_ylim, mesh.y)):
        low, high = _ends(values)
        set_limits(low - 0.02 * (high - low), high + 0.02 * (high - low))
    axes.set_aspect("equal")
    axes.set(xlabel="$x$", ylabel="$y$")
    axes.spines[:].set_visible(False)
