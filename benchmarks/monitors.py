"""How much better than the uniform mesh every monitor interpolates, with and without smoothing.

Prints a table for every radius of smoothing, with entries like ``7.2 / 3.0 c0.01, 1.4 s``: L2 gain and H1 gain (error
of bilinear interpolation on the uniform mesh over that on the adapted one); where the mesh was relaxed, "c" with the
weight of the cross-line term, "a" or "s" with the strength that was reached; CPU seconds of the solve. All with default
settings otherwise, on one thread.

    python benchmarks/monitors.py --points 65 --functions paper wave
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import functions

import equimesh as em

RADII = (0.0, 0.01, 0.02, 0.04)
FUNCTIONS = {name: functions.FUNCTIONS[name].u for name in ("paper", "wave", "tanh60", "gauss", "franke", "sine")} | {
    "ring100": "tanh(100*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
    "ring150": "tanh(150*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
}
CHOOSERS: dict[str, Callable[[em.Field], em.Monitor]] = {
    "auto, for interpolation": lambda u: em.Auto(u=u, purpose="interpolation"),
    "least error l2": lambda u: em.LeastError(u=u),
    "least error h1": lambda u: em.LeastError(u=u, norm="h1"),
    "least error l2, smoothness 0.1": lambda u: em.LeastError(u=u, smoothness=0.1),
}
METRICS: dict[str, Callable[[em.Field], em.Monitor]] = {
    "arc length, a = 0.7": lambda u: em.ArcLength(u=u),
    "arc length, a = 1": lambda u: em.ArcLength(u=u, a=1.0),
    "arc length, a = 1, b = 0.01": lambda u: em.ArcLength(u=u, a=1.0, b=0.01),
    "curvature l2": lambda u: em.Curvature(u=u),
    "curvature h1": lambda u: em.Curvature(u=u, norm="h1"),
    "curvature l2, isotropic": lambda u: em.Curvature(u=u, isotropic=True),
    "arc length and curvature l2": lambda u: em.Intersection(monitors=(em.ArcLength(u=u), em.Curvature(u=u))),
}


def smoothed(monitor: em.Monitor, radius: float) -> em.Monitor:
    """The monitor, smoothed where the radius is not zero."""
    return em.Smoothed(monitor=monitor, radius=radius) if radius else monitor


def entry(monitor: em.Monitor, points: int) -> str:
    """The gain of a solve with the monitor, its relaxations, and its time."""
    start = time.process_time()
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=points, n_eta=points))
    solution = em.solve(problem, threads=1, check=False)
    seconds = time.process_time() - start
    marks = {"cross_line": "c", "a": "a", "strength": "s", "points": "n"}
    relaxed = "".join(f" {marks[one.what]}{one.reached:.2g}" for one in solution.relaxed)
    gain = solution.interpolation
    if gain is None or not solution.status.succeeded:
        return str(solution.status)
    return f"{gain.gain_l2:.2g} / {gain.gain_h1:.2g}{relaxed}, {seconds:.1f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=65, help="points a side")
    parser.add_argument("--functions", nargs="+", default=list(FUNCTIONS), choices=FUNCTIONS, help="names of functions")
    parser.add_argument("--radii", type=float, nargs="+", default=RADII, help="radii of smoothing, 0 for none")
    arguments = parser.parse_args()
    for name in arguments.functions:
        print(f"{name} is `{FUNCTIONS[name]}`")
    for radius in arguments.radii:
        print(f"\nradius {radius:g}, {arguments.points} x {arguments.points} points\n")
        print("| monitor | " + " | ".join(arguments.functions) + " |")
        print("|---" * (len(arguments.functions) + 1) + "|")
        for title, monitor in (METRICS if radius else CHOOSERS | METRICS).items():
            fields = (em.Expression(FUNCTIONS[name]) for name in arguments.functions)
            entries = [entry(smoothed(monitor(u), radius), arguments.points) for u in fields]
            print(f"| {title} | " + " | ".join(entries) + " |", flush=True)


if __name__ == "__main__":
    main()
