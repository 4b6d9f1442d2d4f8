"""Pictures of a convergence: of the Schwarz iteration, and of a descent."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from equimesh.numerics.types import Array
from equimesh.plot.figure import COLOURS, LINE_STYLES, MARKERS, figure_file, iteration_axis, semilog

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Pictures of a descent: the interpolation error and its gain, step by step, on one nested grid after the other.

STARTS = ("uniform", "rectilinear", "given")
"""The first meshes of descents, in the order of the styles of their lines."""
MAX_MARKERS = 25
"""Markers on a line, about."""


def draw_descent(records: Sequence[Mapping[str, Any]], path: str | Path) -> None:
    """Draw the steps of a least-error solve: above the error, below how many times smaller it is than at the start.

    ``records`` are those of ``descent`` in the JSON object of ``GET /v1/meshes/{id}/convergence``. Each grid has a
    colour, and each first mesh a style of its lines. A gain that is not known leaves a gap. Records of blocks have no
    ``grid`` but a number of ``points``, and gains against the mesh that they began with.
    """
    of_blocks = any(not record.get("grid") for record in records)
    with figure_file(path, 6.6, 6.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1.0))
        colours: dict[str, str] = {}
        for (grid, start), steps, line in _lines(records):
            known = grid in colours
            colour = colours.setdefault(grid, COLOURS[len(colours) % len(COLOURS)])
            number = STARTS.index(start) if start in STARTS else 0
            style: dict[str, Any] = {
                "color": colour,
                "linestyle": LINE_STYLES[number % len(LINE_STYLES)],
                "marker": MARKERS[number % len(MARKERS)],
                "markersize": 4,
                "markevery": max(1, steps.size // MAX_MARKERS),
            }
            label = None if known else f"{grid} points"
            upper.plot(steps, _column(line, "error"), label=label, **style)
            lower.plot(steps, _column(line, "gain"), **style)
        used = [start for start in STARTS if any(record.get("start") == start for record in records)]
        for start in used if len(used) > 1 else []:
            number = STARTS.index(start)
            marker, line_style = MARKERS[number], LINE_STYLES[number]
            upper.plot([], [], color="#888888", marker=marker, linestyle=line_style, label=f"from a {start} mesh")
        title = f"Descent on nested {'meshes' if of_blocks else 'grids'}"
        upper.set(title=title, ylabel="interpolation error", yscale="log")
        lower.set(
            xlabel="step",
            ylabel=f"times smaller than\non the {'initial' if of_blocks else 'uniform'} mesh",
            yscale="log",
        )
        upper.legend(loc="upper right", fontsize=9)
        for axes in (upper, lower):
            axes.grid(True)


def _lines(
    records: Sequence[Mapping[str, Any]],
) -> Iterator[tuple[tuple[str, str], Array, list[Mapping[str, Any]]]]:
    """The grid and the start of each part of the descent, the numbers of its steps, and its records."""

    def part(numbered: tuple[int, Mapping[str, Any]]) -> tuple[str, str]:
        grid = numbered[1].get("grid")
        size = f"{grid[0]} x {grid[1]}" if grid else str(numbered[1].get("points", "?"))
        return size, str(numbered[1].get("start", ""))

    for key, members in groupby(enumerate(records), part):
        pairs = list(members)
        yield key, np.array([number for number, _ in pairs], dtype=np.float64), [record for _, record in pairs]


def _column(records: Sequence[Mapping[str, Any]], name: str) -> Array:
    values = np.array([record.get(name) for record in records], dtype=np.float64)  # None becomes nan
    return np.where(values > 0.0, values, np.nan)


MAX_COMPONENTS = 4
"""Errors by subdomain and coordinate are drawn when there are at most this many lines of them."""


WORDS = {
    "error": "error against the single domain",
    "change": "largest change of a node",
    "estimate": "estimated error",
    "mismatch": "mismatch of the subdomains",
    "deviation": "deviation of the metric along lines (relative)",
}
"""The lines in the picture of a Schwarz iteration: errors, else changes, and the names below them here."""

MIN_PREDICTED_RATE = 0.05
"""A smaller predicted rate is not shown: what the prediction leaves out, the coupling of grid lines, then decides."""


def draw_convergence(convergence: Mapping[str, Any], path: str | Path) -> None:
    """Draw a Schwarz iteration: its error or else its change, the other quantities of ``WORDS``, and max ``Q_eq``.

    A predicted rate is shown from ``MIN_PREDICTED_RATE`` on. Iterations that deviated from the request are marked.

    ``convergence`` is the JSON object of ``GET /v1/meshes/{id}/convergence``. Where there are at most
    ``MAX_COMPONENTS`` errors of x and y in subdomains, they are drawn: the history of Haynes and Howse. A history with
    a ``descent`` in place of iterations is drawn by :func:`~equimesh.plot.convergence.draw_descent`.
    """
    if convergence.get("descent"):
        draw_descent(convergence["descent"], path)
        return
    records = list(convergence.get("iterations") or ())
    at = _numbers(record.get("iteration", index) for index, record in enumerate(records))
    largest = _numbers(record.get("max_q_eq") for record in records)
    largest[~np.isfinite(largest)] = np.nan
    rates = {"rate": "measured", "predicted_rate": "predicted"}
    known = {label: convergence.get(key) for key, label in rates.items()}
    if (known["predicted"] or 0.0) < MIN_PREDICTED_RATE:
        known["predicted"] = None
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


def _numbers(values: Iterable[float | None]) -> Array:
    return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)


def _series(records: Sequence[Mapping[str, Any]], at: Array) -> dict[str, tuple[Array, Array]]:
    """The lines on a logarithmic axis, by label; of the start only its error."""
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
    if len(found) > MAX_COMPONENTS:
        return {}
    return {
        label: (_numbers(p[0] for p in pairs), _numbers(p[1] for p in pairs)) for label, pairs in sorted(found.items())
    }
