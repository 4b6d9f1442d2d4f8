"""Pictures of meshes and of convergence, as PNG or SVG files.

Needs matplotlib: ``pip install 'equimesh[plot]'``. Every function draws one file and nothing else: no window,
no pyplot, no setting that outlives the call. Equal data give equal files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.plot.figure import figure_file, iteration_axis, semilog
from equimesh.plot.mesh_lines import SHARED, MeshLines
from equimesh.schwarz.decomposition import Decomposition

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array: TypeAlias = npt.NDArray[np.float64]

MOST_LINES = 200
"""A mesh with more lines than this in a direction is drawn by every k-th line, and the title says so."""
MOST_SURFACE_LINES = 80
"""The same for the surface in three dimensions."""
MOST_CELLS_WITH_EDGES = 80
"""Cells in a direction up to which the picture of a measure shows their edges."""
MOST_COMPONENTS = 4
"""Errors by subdomain and coordinate are drawn when there are at most this many lines of them."""
MOST_LABELS = 12
"""A legend of subdomains has at most this many entries; of more, the title gives the number."""
SUBDOMAIN_COLOURS = ("#d62728", "#1f4fd8", "#009e73", "#e69f00", "#56b4e9", "#7f5539")
"""Red and blue as in the paper, then colours that stay apart for colour-blind eyes."""
OVERLAP_COLOUR = "#8e24aa"
SINGLE_COLOUR = "#22577a"
WORDS = {
    "error": "error against the single domain",
    "change": "largest change of a node",
    "estimate": "estimated error",
    "mismatch": "mismatch of the subdomains",
    "deviation": "deviation of the metric along lines (relative)",
}
"""What the picture of a Schwarz iteration shows: errors, else changes, and what is below them here."""


def draw_mesh(
    data: MeshData,
    path: str | Path,
    *,
    decomposition: Decomposition | None = None,
    show_subdomains: bool = True,
) -> None:
    """Draw the lines of the mesh to ``path``, ``.png`` or ``.svg``.

    With a ``decomposition`` every subdomain has its colour, the first red and the second blue, and what they
    share is purple, as in the 18 x 18 mesh of Haynes and Howse. Without one, the colours tell which subdomain
    the cells were taken from. ``show_subdomains=False`` draws all lines in one colour.
    """
    decomposition = decomposition if show_subdomains else None
    lines = MeshLines.of(data.mesh, most=MOST_LINES, decomposition=decomposition)
    edges = lines.owners(data.subdomain if show_subdomains else np.zeros_like(data.subdomain), decomposition)
    owners = sorted(np.union1d(*edges).tolist(), key=lambda owner: (owner == SHARED, owner))
    with figure_file(path, 6.0, 6.4) as figure:
        from matplotlib.collections import LineCollection

        axes = figure.add_subplot()
        width = min(1.2, max(0.3, 36 / max(lines.x.shape)))
        for owner in owners:  # the overlap last, on top
            if len(owners) == 1:
                colour, label = SINGLE_COLOUR, "mesh"
            elif owner == SHARED:
                colour, label = OVERLAP_COLOUR, "overlap"
            else:
                colour, label = SUBDOMAIN_COLOURS[owner % len(SUBDOMAIN_COLOURS)], f"subdomain {owner + 1}"
            pieces = lines.polylines(*edges, owner)
            axes.add_collection(LineCollection(pieces, colors=colour, linewidths=width, label=label))
        _physical_plane(axes, data.mesh)
        many = (
            f", {len([owner for owner in owners if owner != SHARED])} subdomains" if len(owners) > MOST_LABELS else ""
        )
        axes.set_title(f"Mesh of {_size(data.mesh)}{many}{lines.remark}")
        if 1 < len(owners) <= MOST_LABELS:
            legend = figure.legend(loc="outside lower center", ncols=3 if len(owners) in (3, 5, 6, 9) else 4)
            for handle in legend.get_lines():
                handle.set_linewidth(2.0)


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
        for part in parts if len(parts) <= MOST_LABELS else ():
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
    with figure_file(path, 6.6, 5.8) as figure:
        from matplotlib import colormaps
        from matplotlib.collections import LineCollection
        from matplotlib.colors import LogNorm
        from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

        axes = figure.add_subplot()
        coloured = axes.pcolormesh(
            mesh.x,
            mesh.y,
            q,
            cmap=colormaps["PuOr"].with_extremes(bad="#777777"),
            norm=LogNorm(1 / spread, spread),
            rasterized=q.size > MOST_CELLS_WITH_EDGES**2,
        )
        if max(q.shape) <= MOST_CELLS_WITH_EDGES:
            lines = MeshLines.of(mesh, most=MOST_CELLS_WITH_EDGES)
            pieces = lines.polylines(*lines.owners(np.zeros_like(data.subdomain), None), 0)
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
    lines = MeshLines.of(data.mesh, most=MOST_SURFACE_LINES)
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


def draw_convergence(convergence: Mapping[str, Any], path: str | Path) -> None:
    """Draw a Schwarz iteration: its error, or its change where no error is known, with what else ``WORDS`` names, and
    max ``Q_eq``; marked are the iterations in which something else was done than asked.

    ``convergence`` is the JSON object of ``GET /v1/meshes/{id}/convergence``. Where there are at most
    ``MOST_COMPONENTS`` errors of x and y in subdomains, they are drawn: the history of Haynes and Howse.
    """
    records = list(convergence.get("iterations") or ())
    at = _numbers(record.get("iteration", index) for index, record in enumerate(records))
    largest = _numbers(record.get("max_q_eq") for record in records)
    largest[~np.isfinite(largest)] = np.nan
    rates = {"rate": "measured", "predicted_rate": "predicted"}
    known = {label: convergence.get(key) for key, label in rates.items()}
    parts = [f"{_rate(rate)} {label}" for label, rate in known.items() if rate is not None and math.isfinite(rate)]
    with figure_file(path, 6.6, 7.0 if records else 1.2) as figure:
        if not records:
            figure.text(0.5, 0.5, "No Schwarz iteration: the mesh was computed on a single domain", ha="center")
            return
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
        semilog(upper, _series(records, at))
        _mark(upper, records, at)
        upper.set_title("Schwarz iteration" + (f"\nrate per iteration: {', '.join(parts)}" if parts else ""))
        upper.set_ylabel("in units of the reference square")
        if (inside := upper.get_legend()) is not None:
            inside.remove()
        figure.legend(loc="outside lower center", ncols=2, fontsize=9)
        lower.plot(at, largest, "o-", color="#333333", markersize=4, markevery=max(1, at.size // 25))
        lower.set_ylabel("max $Q_{eq}$")
        lower.ticklabel_format(axis="y", useOffset=False)
        lower.grid(True)
        iteration_axis(lower, at)


def draw_histories(
    histories: Mapping[str, Sequence[float]],
    path: str | Path,
    *,
    title: str,
    ylabel: str = "error",
    first: int = 0,
) -> None:
    """Draw several convergence histories on one logarithmic axis.

    ``histories`` maps a label to its values, one per iteration counted from ``first``. Zeros, which have no
    logarithm, are marked at the bottom, infinite values at the top; nan leaves a gap.
    """
    values = {label: _numbers(history) for label, history in histories.items()}
    series = {label: (first + np.arange(v.size, dtype=np.float64), v) for label, v in values.items()}
    with figure_file(path, 6.6, 4.8) as figure:
        axes = figure.add_subplot()
        semilog(axes, series)
        axes.set(title=title, ylabel=ylabel)
        iteration_axis(axes, np.concatenate([at for at, _ in series.values()] or [np.zeros(0)]))


def _rate(rate: float) -> str:
    return f"{rate:.3f}" if rate >= 0.01 else f"{rate:.2g}"


def _size(mesh: Mesh) -> str:
    return f"{mesh.x.shape[0]} × {mesh.x.shape[1]} points"


def _physical_plane(axes: Axes, mesh: Mesh) -> None:
    """Equal scales, and limits that leave the mesh a narrow margin."""
    for set_limits, values in ((axes.set_xlim, mesh.x), (axes.set_ylim, mesh.y)):
        finite = values[np.isfinite(values)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        set_limits(low - 0.02 * (high - low), high + 0.02 * (high - low))
    axes.set_aspect("equal")
    axes.set(xlabel="$x$", ylabel="$y$")
    axes.spines[:].set_visible(False)


def _numbers(values: Iterable[float | None]) -> Array:
    return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)


def _series(records: Sequence[Mapping[str, Any]], at: Array) -> dict[str, tuple[Array, Array]]:
    """What is drawn of the iterations on a logarithmic axis; of the start only its error."""
    kind = "error" if any(record.get("error") is not None for record in records) else "change"
    series = _components(records) if kind == "error" else {}
    for name, label in WORDS.items():
        values = _numbers(record.get(name) for record in records)
        if name == kind:
            series = series or {label: (at, values)}
        elif name not in ("error", "change") and (values[1:] > 0).any():
            series[label] = (at[1:], values[1:])
    return series


def _mark(axes: Axes, records: Sequence[Mapping[str, Any]], at: Array) -> None:
    """Lines where another condition took over, and crosses below the iterations that took a step on the whole grid."""
    names = [record.get("transmission") for record in records]
    for k in range(1, len(names)):
        if names[k] != names[k - 1]:
            label = f"{names[k]} took over from {names[k - 1]}"
            axes.axvline((at[k - 1] + at[k]) / 2, color="#555555", linestyle=(0, (1, 1.5)), label=label)
    steps = [place for place, record in zip(at, records, strict=True) if record.get("global_step")]
    if steps:
        below = axes.get_xaxis_transform()
        label = "Newton step on the whole grid"
        axes.plot(steps, [0.05] * len(steps), "x", color="#333333", label=label, transform=below)


def _components(records: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Array, Array]]:
    """Errors of x and y in every subdomain against the iteration; empty when they are too many."""
    found: dict[str, list[tuple[float, float]]] = {}
    for index, record in enumerate(records):
        for part in record.get("subdomains") or ():
            for name in ("x", "y"):
                if part.get(f"error_{name}") is not None:
                    label = f"error of ${name}$ in subdomain {part['subdomain'] + 1}"
                    found.setdefault(label, []).append((record.get("iteration", index), part[f"error_{name}"]))
    if len(found) > MOST_COMPONENTS:
        return {}
    return {
        label: (_numbers(p[0] for p in pairs), _numbers(p[1] for p in pairs)) for label, pairs in sorted(found.items())
    }
