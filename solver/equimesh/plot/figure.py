"""Figures of matplotlib without its global state, and the logarithmic axes that convergence is drawn on."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Series: TypeAlias = Mapping[str, tuple[Array, Array]]

METADATA: dict[str, dict[str, str | None]] = {
    ".png": {"Software": "equimesh"},
    ".svg": {"Creator": "equimesh", "Date": None},
}
"""The suffixes of pictures, and their metadata: nothing that changes from one run to the next."""
RESOLUTION = 150
"""Dots per inch of a PNG."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#333333")
"""Colours of lines, of Okabe and Ito: they stay apart for colour-blind eyes."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINE_STYLES = ("-", "--", ":")
MAX_ZERO = 1e-250
"""A logarithmic axis shows smaller values as zero."""
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
_ONE_AT_A_TIME = threading.Lock()  # matplotlib's settings are the process's while a figure is drawn


@contextmanager
def figure_file(path: str | Path, width: float, height: float) -> Iterator[Figure]:
    """A figure of ``width`` x ``height`` inches that is written to ``path`` when the block ends.

    Raises :class:`~equimesh.errors.InputError` for another suffix than those of ``METADATA``, and
    ``ImportError`` without matplotlib.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in METADATA:
        raise InputError(f"{path.name}: pictures are written as {' or '.join(METADATA)}", field="path")
    try:
        import matplotlib.style
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError("drawing needs matplotlib: pip install 'equimesh[plot]'") from error
    with _ONE_AT_A_TIME, matplotlib.style.context(["default", STYLE]):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        figure.savefig(path, format=suffix[1:], dpi=RESOLUTION, metadata=METADATA[suffix])


def semilog(axes: Axes, series: Series) -> None:
    """Draw labelled ``(iteration, value)`` lines on a logarithmic axis.

    Zeros are marked at the bottom of the axes and infinite values at the top; nan leaves a gap.
    """
    values = np.concatenate([value for _, value in series.values()] or [np.zeros(0)])
    positive = values[np.isfinite(values) & (values > MAX_ZERO)]
    low, high = np.log10([positive.min(), min(positive.max(), 1 / MAX_ZERO)]) if positive.size else (-16.0, 0.0)
    margin = max(0.2 + 0.04 * (high - low), 0.6 - 0.5 * (high - low))
    axes.set_yscale("log")
    axes.set_ylim(10 ** (low - margin), 10 ** (high + margin))
    for number, (label, (at, value)) in enumerate(series.items()):
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(
            at,
            np.where(np.isfinite(value) & (value > MAX_ZERO), value, np.nan),
            LINE_STYLES[number // len(COLOURS) % len(LINE_STYLES)],
            color=colour,
            marker=MARKERS[number % len(MARKERS)],
            markersize=5,
            markerfacecolor="white",
            markevery=max(1, value.size // 25),
            linewidth=1.4,
            label=label,
        )
        for height, end, where in ((0.02, "v", abs(value) <= MAX_ZERO), (0.98, "^", np.isinf(value))):
            heights = np.full(int(where.sum()), height)
            axes.plot(at[where], heights, end, color=colour, transform=axes.get_xaxis_transform())
    for label, end, some in (
        ("zero", "v", (abs(values) <= MAX_ZERO).any()),
        ("infinite", "^", np.isinf(values).any()),
    ):
        if some:
            axes.plot([], [], end, color="#888888", label=label)
    axes.grid(True)
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(fontsize=9)


def iteration_axis(axes: Axes, at: Array) -> None:
    """An axis of iteration numbers: whole ones, with room around a single one."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlabel("iteration")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    low, high = (float(at.min()), float(at.max())) if at.size else (0.0, 0.0)
    margin = max(0.03 * (high - low), 0.2)
    axes.set_xlim(low - margin, high + margin)
