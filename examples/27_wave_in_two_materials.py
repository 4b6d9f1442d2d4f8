"""Sound that meets a heavier material: nodes stay on the interface, where the slope of the pressure jumps.

div(grad(p) / rho) + k^2 p / rho = 0. Below a slanted line k is 4 and rho is 1, above it they are 7 and 20. A plane
wave, its reflection and its refraction by Snell's law give the values on the sides and the errors that are printed.
With scikit-fem, in complex numbers. Cells that lie in both materials take a part of their values from the wrong one.

    pip install 'equimesh[solver,plot]' scikit-fem && python 27_wave_in_two_materials.py
"""

import argparse
from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure
from skfem.helpers import dot, grad

import equimesh as em

K, RHO, CELLS = (4.0, 7.0), (1.0, 20.0), (32, 32)  # below and above
SLOPE = 0.25  # the interface is y = 0.35 + 0.25 x
NORMAL = np.array([-SLOPE, 1.0]) / np.hypot(1.0, SLOPE)
ALONG = np.array([1.0, SLOPE]) / np.hypot(1.0, SLOPE)


def height(x, y):
    """The distance above the interface."""
    return NORMAL[0] * x + NORMAL[1] * (y - 0.35)


def wave(x, y):
    """The wave, which comes from below at 30 degrees to the normal."""
    s, along = height(x, y), K[0] * np.sin(np.pi / 6)
    below, above = (np.sqrt(k**2 - along**2) for k in K)
    reflected = (below / RHO[0] - above / RHO[1]) / (below / RHO[0] + above / RHO[1])
    parts = np.exp(1j * below * s) + reflected * np.exp(-1j * below * s), (1 + reflected) * np.exp(1j * above * s)
    return np.exp(1j * along * (ALONG[0] * x + ALONG[1] * (y - 0.35))) * np.where(s < 0, *parts)


def solve(mesh):
    """The wave at the nodes."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=4)
    is_below = height(*basis.global_coordinates()) < 0
    rho, k = np.where(is_below, *RHO), np.where(is_below, *K)
    form = skfem.BilinearForm(lambda u, v, w: (dot(grad(u), grad(v)) - w.k**2 * u * v) / w.rho, dtype=np.complex128)
    known = wave(*basis.doflocs)
    return skfem.solve(*skfem.condense(form.assemble(basis, k=k, rho=rho), x=known, D=basis.get_dofs()))


def error(mesh, values):
    """The relative error in the L2 norm."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=10)
    known = wave(*basis.global_coordinates())
    found = basis.interpolate(values.real) + 1j * np.asarray(basis.interpolate(values.imag))
    return float(np.sqrt((abs(found - known) ** 2 * basis.dx).sum() / (abs(known) ** 2 * basis.dx).sum()))


def main(output: Path) -> None:
    line = {"polyline": [[0, 0.35], [1, 0.35 + SLOPE]]}
    finer = tuple(3 * n for n in CELLS)
    meshes = {
        "uniform": em.Blocks.rectangle(cells=CELLS).mesh,
        "uniform, nine times the cells": em.Blocks.rectangle(cells=finer).mesh,
        "nodes on the interface": em.Blocks.rectangle(cells=CELLS, curves={"interface": line}).mesh,
    }
    for name, mesh in meshes.items():
        print(f"{name}: relative L2 error {error(mesh, solve(mesh)):.2%}")
    figure = Figure(figsize=(5.4, 5.4), layout="constrained")
    axes = figure.add_subplot(title="the real part of the wave", aspect="equal")
    mesh = meshes["nodes on the interface"]
    triangles = mesh.mesh_parts("triangle").cells
    axes.tripcolor(*mesh.points.T, triangles, solve(mesh).real, shading="gouraud", cmap="RdBu")
    for nodes in mesh.blocks:
        x, y = mesh.x[nodes], mesh.y[nodes]
        axes.plot(x, y, x.T, y.T, color="black", linewidth=0.2)
    figure.savefig(output / "two-materials.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
