"""The mismatch of subdomains, iteration by iteration, and how it depends on their number.

The paper's u, 65 x 65 points, 4 of overlap, a = 0.7, b = 0.05, from the mesh of a grid half as fine. The optimized
condition takes local data, or sums along whole grid lines; line corrections and acceleration would hide which.

    pip install 'equimesh[solver,plot]'
    python 13_schwarz_mismatch.py
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import equimesh as em
from equimesh.plot import COLOURS, MARKERS, figure_file, iteration_axis

U = em.Expression("(1 - exp(15*(x - 1))) * sin(pi*y)")
PROBLEM = em.Problem(monitor=em.ArcLength(u=U, a=0.7, b=0.05), grid=em.Grid(n_xi=65, n_eta=65))
LAST, GOAL, ROUNDING = 21, 1e-6, 1e-14
COMMON = em.Schwarz(subdomains=(4, 1), fallback=False, tolerance=None, max_iterations=LAST, compare_single_domain=True)
ALONE = replace(COMMON, line_correction=0, acceleration=em.Acceleration.NONE)
TURNS = replace(COMMON, ordering=em.Ordering.ALTERNATING, max_iterations=6)
KINDS = {
    "classical": replace(COMMON, transmission=em.Classical()),
    "linear Robin, taking turns": replace(TURNS, transmission=em.LinearRobin(p="auto")),
    "optimized alone": ALONE,
    "default: + lines + Anderson": COMMON,
}
DATA = {
    f"{words}, {strips} strips": replace(ALONE, transmission=em.Optimized(data=data), subdomains=(strips, 1))
    for words, data in (("local data", em.LineData.LOCAL), ("line sums", em.LineData.LINE_SUMS))
    for strips in (2, 4, 8)
}


def plot(axes: Any, solutions: Mapping[str, em.Solution], what: str, title: str) -> None:
    """Histories down to rounding; local data dashed, in the colours of line sums."""
    for number, (label, solution) in enumerate(solutions.items()):
        values = np.array([getattr(record, what) or np.nan for record in solution.iterations])
        values[np.fmin.accumulate(values) < ROUNDING] = np.nan
        which, dashed = (number % 3, number < 3) if solutions.keys() == DATA.keys() else (number + 3, False)
        style = {"color": COLOURS[which], "marker": MARKERS[which], "linestyle": "--" if dashed else "-"}
        axes.semilogy(values, label=label, markersize=5, markerfacecolor="white", **style)
    if what == "error":
        goal = GOAL * solution.iterations[0].error
        axes.axhline(goal, color="#555555", linewidth=1)
        axes.text(20, goal / 2, "1e-6 of the start's", fontsize=8, ha="right", va="top")
    axes.set_title(title, fontsize=11)
    axes.grid(True)
    iteration_axis(axes, np.arange(LAST + 1))
    axes.legend(loc="upper center", bbox_to_anchor=(0.48, -0.14), ncols=2, fontsize=8, columnspacing=1)


def main(output: Path) -> None:
    kinds, data = ({k: em.solve(PROBLEM, s, check=False) for k, s in group.items()} for group in (KINDS, DATA))
    path = output / "schwarz-mismatch.png"
    print("mismatch after 1, 3 and 6 iterations; iterations until the error is 1e-6 of the start's")
    for name, solution in (kinds | data).items():
        errors = [record.error for record in solution.iterations]
        needed = [str(k) for k, error in enumerate(errors) if error <= GOAL * errors[0]]
        shown = "  ".join(f"{solution.iterations[k].mismatch:.1e}" for k in (1, 3, 6))
        print(f"  {name:<27}  {shown}  {[*needed, f'>{len(errors) - 1}'][0]:>4}")
    with figure_file(path, 12.0, 4.8) as figure:
        left, middle, right = figure.subplots(1, 3, sharey=True)
        plot(left, kinds, "mismatch", "mismatch on 4 strips")
        plot(middle, data, "mismatch", "mismatch, optimized alone")
        plot(right, data, "error", "error, optimized alone")
        left.set_ylabel("in units of the reference square")
        figure.suptitle("Paper's u: 65 × 65 points, overlap 4", fontsize=12)
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
