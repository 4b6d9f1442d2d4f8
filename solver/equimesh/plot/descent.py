"""Pictures of a descent: the interpolation error and its gain, step by step, on one nested grid after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.numerics.types import Array
from equimesh.plot.figure import COLOURS, LINE_STYLES, MARKERS, figure_file

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
        upper.legend(fontsize=9)
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
