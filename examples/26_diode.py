"""The potential of a diode, and a mesh for the logarithm of its electrons, which vary over ten orders of magnitude.

-lambda^2 Laplace(psi) = exp(-psi) - exp(psi) + C, the equilibrium of a p-n junction, by Newton's method with
scikit-fem. C is the doping, which changes its sign across a curve. The mesh follows log10(n) = psi / ln 10, since n
itself would show the n region alone. The charge of the n region is compared with the limit of those on finer uniform
meshes.

    pip install 'equimesh[solver,plot]' scikit-fem && python 26_diode.py
"""

import argparse
from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure
from skfem.helpers import dot, grad

import equimesh as em

N, FINER, DEBYE, DOPING, STEEP = 33, (65, 129), 0.01, 1e5, 80.0


def doping(x, y):
    """The doping over the density of intrinsic carriers: a round n region at a corner, in a p region."""
    return DOPING * np.tanh(STEEP * (0.5 - np.hypot(x, y)))


def solve(mesh):
    """The potential at the nodes, in units of the thermal voltage."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=4)
    scale = DEBYE**2
    form = skfem.BilinearForm(lambda u, v, w: scale * dot(grad(u), grad(v)) + np.cosh(w.psi) * 2 / DOPING * u * v)
    load = skfem.LinearForm(
        lambda v, w: scale * dot(w.psi.grad, grad(v)) + (2 * np.sinh(w.psi) - doping(*w.x)) / DOPING * v
    )
    psi = np.arcsinh(0.5 * doping(*basis.doflocs))  # where the charge is 0
    contacts = basis.get_dofs(lambda x: (np.hypot(*x) < 0.25) & (x[0] * x[1] == 0) | (x[0] + x[1] > 1.75))
    for _ in range(60):
        now = basis.interpolate(psi)
        update = skfem.solve(*skfem.condense(form.assemble(basis, psi=now), -load.assemble(basis, psi=now), D=contacts))
        psi = psi + np.clip(update, -2.0, 2.0)
        if np.abs(update).max() < 1e-9:
            return psi
    raise RuntimeError("Newton's method did not converge")


def charge(mesh, psi):
    """The charge of the n region that no electron balances, in units of the doping."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=8)
    at = doping(*basis.global_coordinates())
    return float(((at - 2 * np.sinh(basis.interpolate(psi.ravel()))) / DOPING * basis.dx)[at > 0].sum())


def main(output: Path) -> None:
    found = em.adapt(lambda mesh: solve(mesh) / np.log(10.0), N, rounds=3)
    adapted = charge(found.mesh, found.values * np.log(10.0))
    uniform = [em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n)) for n in (N, *FINER)]
    coarse, fine, finest = (charge(mesh, solve(mesh)) for mesh in uniform)
    known = finest + (finest - fine) / 3  # errors are a quarter on cells of half the width
    print(f"log10(n) from {found.values.min():.1f} to {found.values.max():.1f}")
    print(f"charge {known:.5f}: adapted {adapted:.5f}, uniform {coarse:.5f}")
    print(f"error: adapted {abs(adapted / known - 1):.3%}, uniform {abs(coarse / known - 1):.3%}")
    figure = Figure(figsize=(5.4, 5.4), layout="constrained")
    axes = figure.add_subplot(title="log10 of the electrons", aspect="equal")
    mesh = found.mesh
    figure.colorbar(axes.pcolormesh(mesh.x, mesh.y, found.values.reshape(mesh.x.shape), shading="gouraud"))
    axes.plot(mesh.x, mesh.y, mesh.x.T, mesh.y.T, color="black", linewidth=0.3)
    figure.savefig(output / "diode.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
