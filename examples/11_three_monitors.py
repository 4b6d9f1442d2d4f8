"""One function on a uniform mesh, and on those of three monitors: arc length, curvature and least error.

pip install 'equimesh[solver,plot]'
python 11_three_monitors.py --output ../docs/images
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from PIL import Image

import equimesh as em
from equimesh.plot import figure_file

# A layer along the right side, a front that meets it, and a hill.
U = em.Expression("exp(-40*(1 - x)) + tanh(30*(y - 0.3 - 0.2*x))/2 + exp(-40*((x - 0.3)**2 + (y - 0.75)**2))/2")
MONITORS = {
    "arc length": em.ArcLength(u=U),
    "curvature": em.Smoothed(monitor=em.Curvature(u=U), radius=0.01),
    "least error": em.LeastError(u=U),
}


def report(name: str, solution: em.Solution) -> str:
    """One line for a solution, from its certificate."""
    certificate = solution.certificate
    relaxed = "".join(f", {one.what} {one.reached:g}" for one in certificate.relaxed)
    gain = certificate.interpolation
    return f"{name:<11}  L2 gain {gain.gain_l2:.2f}, H1 gain {gain.gain_h1:.2f}, {certificate.status}{relaxed}"


def draw(solutions: dict[str, em.Solution], path: Path) -> None:
    """The uniform mesh and the others next to each other, over the level lines of u."""
    first = next(iter(solutions.values()))
    meshes = {"uniform": em.Mesh.uniform(first.problem.grid)}
    meshes |= {
        f"{name}: error {solution.interpolation.gain_l2:.1f} times smaller": solution.mesh
        for name, solution in solutions.items()
    }
    axis = np.linspace(0.0, 1.0, 129)
    (u,) = U.evaluate(*np.meshgrid(axis, axis))
    with figure_file(path, 6.4, 6.8) as figure:
        panels = figure.subplots(2, 2).ravel()
        for axes, (title, mesh) in zip(panels, meshes.items(), strict=True):
            axes.contour(axis, axis, u, levels=12, cmap="plasma", linewidths=1.0)
            lines = [
                np.column_stack(q) for x, y in ((mesh.x, mesh.y), (mesh.x.T, mesh.y.T)) for q in zip(x, y, strict=True)
            ]
            axes.add_collection(LineCollection(lines, colors="black", linewidths=0.35))
            axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal", xticks=(), yticks=())
            axes.set_title(title, fontsize=8)
    Image.open(path).convert("RGB").quantize(10).save(path, optimize=True)


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
