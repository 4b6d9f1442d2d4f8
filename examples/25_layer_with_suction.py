"""A boundary layer with suction: cells of a given height at the wall, and a mesh that follows the layer above them.

-nu Laplace(u) + u_x - v u_y = 0 above a wall through which the fluid leaves with the speed v: u = 1 - exp(-v y / nu),
the asymptotic suction profile, with scikit-fem and without stabilisation. The first cell is a fifth of nu / v.

    pip install 'equimesh[solver,plot]' scikit-fem && python 25_layer_with_suction.py
"""

import argparse
from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure
from skfem.helpers import dot, grad

import equimesh as em

NU, V = 1e-3, 0.1
LAYER = NU / V


def profile(y):
    """u, and its derivative."""
    return 1 - np.exp(-y / LAYER), np.exp(-y / LAYER) / LAYER


def solve(mesh):
    """The speed at the nodes."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=4)
    form = skfem.BilinearForm(lambda u, w, _: NU * dot(grad(u), grad(w)) + (grad(u)[0] - V * grad(u)[1]) * w)
    known = profile(basis.doflocs[1])[0]
    return skfem.solve(*skfem.condense(form.assemble(basis), x=known, D=basis.get_dofs()))


def friction(mesh, speed):
    """The mean derivative at the wall over the known one, from the first cells alone."""
    wall = mesh.to_skfem(cells="quad").with_boundaries({"wall": lambda x: x[1] < 1e-12})
    basis = skfem.FacetBasis(wall, skfem.ElementQuad1(), facets="wall")
    slope = basis.interpolate(speed.ravel()).grad[1]
    return float((slope * basis.dx).sum() * LAYER)


def error(mesh, speed):
    """The error in the L2 norm."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=8)
    wrong = basis.interpolate(speed.ravel()) - profile(basis.global_coordinates()[1])[0]
    return float(np.sqrt((wrong**2 * basis.dx).sum()))


def main(output: Path) -> None:
    walls = {"bottom": {"first": LAYER / 5, "growth": 1.15, "count": 8}}
    domain = em.Blocks.rectangle((0, 1), (0, 1), cells=(8, 32), layers=walls)
    uniform = em.Blocks.rectangle((0, 1), (0, 1), cells=(8, 32)).mesh
    found = em.adapt(solve, domain=domain, rounds=4)
    mesh, speed = found.mesh, found.values
    heights = np.unique(np.round(mesh.points[np.abs(mesh.x) < 1e-12, 1], 12))
    print(f"heights of the first cells: {', '.join(f'{height:.3e}' for height in np.diff(heights)[:4])}")
    for name, (one, values) in {"adapted": (mesh, speed), "uniform": (uniform, solve(uniform))}.items():
        print(f"{name}: L2 error {error(one, values):.2e}, friction {friction(one, values):.3f} of the known one")
    figure = Figure(figsize=(5.4, 5.4), layout="constrained")
    axes = mesh.plot(figure.add_subplot(title="the lowest tenth of the mesh"))
    axes.set(ylim=(0, 0.1), aspect="auto")
    figure.savefig(output / "layer-with-suction.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
