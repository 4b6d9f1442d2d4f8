"""How much better than the uniform mesh every monitor interpolates, with and without smoothing.

Prints a table: L2 gain / H1 gain (error of bilinear interpolation on the uniform mesh over that on the adapted one), a
"c" with the weight of the cross-line term or an "s" with the strength reached where the mesh was relaxed, and CPU
seconds of the solve. All with default settings otherwise, on one thread.

    python benchmarks/monitors.py --points 65 --functions paper wave
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from functions import FUNCTIONS

import equimesh as em

NAMES = ("paper", "ring100", "ringshock60", "wave", "tanh60", "gauss", "sine", "layers", "franke")
RADII = (0.0, 0.01, 0.02, 0.04)
OWN = {
    "ring100": "tanh(100*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
    "ringshock60": "tanh(60*(sqrt((x - 0.5)**2 + (y - 0.5)**2) - 0.3))",
}
MONITORS: dict[str, Callable[[em.Field], em.Monitor]] = {
    "arc length, a = 0.7": lambda u: em.ArcLength(u=u),
    "arc length, a = 1": lambda u: em.ArcLength(u=u, a=1.0),
    "curvature l2": lambda u: em.Curvature(u=u),
    "curvature h1": lambda u: em.Curvature(u=u, norm="h1"),
    "curvature l2, isotropic": lambda u: em.Curvature(u=u, isotropic=True),
    "arc length and curvature l2": lambda u: em.Intersection(monitors=(em.ArcLength(u=u), em.Curvature(u=u))),
}


def smoothed(monitor: em.Monitor, radius: float) -> em.Monitor:
    """The monitor, smoothed where the radius is not zero."""
    return em.Smoothed(monitor=monitor, radius=radius) if radius else monitor


def entry(monitor: em.Monitor, points: int) -> str:
    """What a solve with the monitor gains, what was relaxed for it, and its time."""
    start = time.process_time()
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=points, n_eta=points))
    solution = em.solve(problem, threads=1, check=False)
    seconds = time.process_time() - start
    marks = {"cross_line": "c", "a": "a", "strength": "s", "points": "n"}
    relaxed = "".join(f" {marks[one.what]}{one.reached:.2g}" for one in solution.relaxed)
    gain = solution.interpolation
    if gain is None or not solution.status.succeeded:
        return str(solution.status)
    return f"{gain.gain_l2:.2f} / {gain.gain_h1:.2f}{relaxed}, {seconds:.1f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=65, help="points a side")
    parser.add_argument("--functions", nargs="+", default=NAMES, choices=[*FUNCTIONS, *OWN], help="names of functions")
    parser.add_argument("--radii", type=float, nargs="+", default=RADII, help="radii of smoothing, 0 for none")
    arguments = parser.parse_args()
    for name in arguments.functions:
        u = em.Expression(OWN.get(name) or FUNCTIONS[name].u)
        print(f"\n{name}: `{u.text}`\n")
        print("| monitor |" + "".join(f" radius {radius:g} |" for radius in arguments.radii))
        print("|---|" + "---|" * len(arguments.radii))
        for title, monitor in MONITORS.items():
            entries = [entry(smoothed(monitor(u), radius), arguments.points) for radius in arguments.radii]
            print(f"| {title} |" + "".join(f" {text} |" for text in entries), flush=True)


if __name__ == "__main__":
    main()
