"""One function, three monitors: arc length, curvature, and both at once, smoothed; the gain of each mesh.

pip install 'equimesh[solver,plot]'
python 11_three_monitors.py --output ../docs/images
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from PIL import Image

import equimesh as em
from equimesh.plot import SINGLE_COLOUR, figure_file

# A layer along the right side, a front that meets it, and a hill.
U = em.Expression("exp(-40*(1 - x)) + tanh(30*(y - 0.3 - 0.2*x))/2 + exp(-40*((x - 0.3)**2 + (y - 0.75)**2))/2")
MONITORS = {
    "arc length": em.ArcLength(u=U),
    "curvature": em.Smoothed(monitor=em.Curvature(u=U), radius=0.01),
    "both": em.Smoothed(monitor=em.Intersection(monitors=(em.ArcLength(u=U), em.Curvature(u=U))), radius=0.01),
}


def report(name: str, solution: em.Solution) -> str:
    """One line for a solution, from its certificate."""
    certificate = solution.certificate
    relaxed = "".join(f", {one.what} {one.reached:g}" for one in certificate.relaxed)
    gain = certificate.interpolation
    return f"{name:<10}  L2 gain {gain.gain_l2:.2f}, H1 gain {gain.gain_h1:.2f}, {certificate.status}{relaxed}"


def draw(solutions: dict[str, em.Solution], path: Path) -> None:
    """The meshes next to each other."""
    with figure_file(path, 10.5, 3.8) as figure:
        panels = figure.subplots(1, len(solutions))
        for axes, (name, solution) in zip(panels, solutions.items(), strict=True):
            x, y = solution.mesh.x, solution.mesh.y
            lines = [np.column_stack(line) for line in (*zip(x, y, strict=True), *zip(x.T, y.T, strict=True))]
            axes.add_collection(LineCollection(lines, colors=SINGLE_COLOUR, linewidths=0.6))
            axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=(), yticks=())
            axes.set_title(f"{name}: error {solution.interpolation.gain_l2:.1f} times smaller")
            axes.spines[:].set_visible(True)
    Image.open(path).convert("RGB").quantize(8).save(path, optimize=True)


def main(output: Path) -> None:
    solutions = {}
    for name, monitor in MONITORS.items():
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=49, n_eta=49))
        solutions[name] = em.solve(problem)
        print(report(name, solutions[name]))
    draw(solutions, output / "three-monitors.png")
    print(f"wrote {output / 'three-monitors.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
