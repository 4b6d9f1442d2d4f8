"""The pictures in the README and in docs/: what a mesh is worth, on a plate with a hole, too; the paper's mesh.

pip install 'equimesh[solver,plot]'
python 10_pictures_of_the_docs.py --output ../docs/images
"""

import argparse
import math
from pathlib import Path

from PIL import Image

import equimesh as em
from equimesh.plot import draw_comparison, draw_histories, draw_mesh

FRONT = "tanh(40*(y - 0.5 - 0.1*sin(2*pi*x)))"
WAVE = "tanh(25*(y - 0.15*sin(4*x)))"
PAPER = "(1 - exp(15*(x - 1))) * sin(pi*y)"


def plate() -> em.Blocks:
    """A square plate with a round hole, in four blocks."""
    angles = [math.radians(45 + 90 * k) for k in range(4)]
    hole = {f"h{k}": [0.3 * math.cos(angle), 0.3 * math.sin(angle)] for k, angle in enumerate(angles)}
    square = {"c0": [1, 1], "c1": [-1, 1], "c2": [-1, -1], "c3": [1, -1]}
    around = [(k, (k + 1) % 4) for k in range(4)]
    return em.Blocks.of(
        {
            "vertices": {**hole, **square},
            "curves": {"circle": {"circle": {"center": [0, 0], "radius": 0.3}}},
            "edges": [{"from": f"h{k}", "to": f"h{after}", "on": "circle"} for k, after in around],
            "blocks": [
                {"corners": [f"h{k}", f"c{k}", f"c{after}", f"h{after}"], "cells": [16, 20]} for k, after in around
            ],
            "sides": {"hole": [[f"h{k}", f"h{after}"] for k, after in around]},
        }
    )


def paper(n: int, overlap: int, transmission: em.TransmissionCondition) -> em.Solution:
    """Ten Schwarz iterations for the paper's mesh, compared with the single domain."""
    problem = em.Problem(
        monitor=em.ArcLength(u=em.Expression(PAPER), a=0.7, b=0.05),
        grid=em.Grid(n_xi=n, n_eta=n),
        boundary=em.Boundary.EQUIDISTRIBUTED_1D,
    )
    settings = em.Schwarz(
        overlap=overlap,
        transmission=transmission,
        ordering=em.Ordering.ALTERNATING,
        tolerance=None,
        max_iterations=10,
        compare_single_domain=True,
    )
    return em.solve(problem, settings, initial=em.Initial.UNIFORM)


def main(output: Path) -> None:
    best = em.Problem(monitor=em.Auto(u=em.Expression(FRONT)), grid=em.Grid(n_xi=33, n_eta=33))
    draw_comparison(em.solve(best).against_uniform, output / "uniform-and-adapted.png")
    wave = em.solve(em.Problem(monitor=em.LeastError(u=em.Expression(WAVE)), domain=plate()))
    draw_comparison(wave.against_uniform, output / "plate-with-hole.png")
    mesh = paper(18, 4, em.LinearRobin(p=2.3))
    draw_mesh(mesh.data(), output / "paper-mesh.png", decomposition=mesh.decomposition)
    methods = {
        "classical": em.Classical(),
        "linear Robin, p = 2": em.LinearRobin(p=2),
        "nonlinear Robin, p = 2": em.NonlinearRobin(p=2),
    }
    histories = {}
    for name, transmission in methods.items():
        records = paper(12, 2, transmission).iterations
        histories[name] = [record.error for record in records if record.error > 1e-12]
    title = "Error against the single-domain mesh, 2 points of overlap"
    draw_histories(histories, output / "three-methods.png", title=title, ylabel="largest error of a node")
    for name in ("uniform-and-adapted", "plate-with-hole", "paper-mesh", "three-methods"):
        path, picture = output / f"{name}.png", Image.open(output / f"{name}.png").convert("RGB")
        in_colour = name in ("uniform-and-adapted", "plate-with-hole")
        few = picture.quantize(160, method=Image.Quantize.MAXCOVERAGE) if in_colour else picture.quantize(24)
        few.save(path, optimize=True)  # a quarter of the bytes
        print(f"wrote {path}, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
