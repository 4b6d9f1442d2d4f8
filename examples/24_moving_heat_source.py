"""Heat from a source that moves, with scikit-fem on meshes that follow the hot spot and carry its heat.

T_t = k Laplace(T) + q on the unit square, T = exp(-|x - c(t)|^2 / (2 s^2)) around a centre c on a circle, which gives q
and the errors that are printed. The same steps on the uniform mesh with as many nodes are the comparison.

    pip install 'equimesh[solver,plot]' scikit-fem && python 24_moving_heat_source.py
"""

import argparse
from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure
from skfem.models.poisson import laplace, mass

import equimesh as em

N, STEPS, TURN, SIZE, K = 25, 12, 0.125, 0.04, 0.01
STEP = TURN / STEPS


def spot(t, x, y):
    """The temperature, and the source that it needs."""
    angle, turn = 2 * np.pi * t, 2 * np.pi * 0.25
    dx, dy = x - 0.5 - 0.25 * np.cos(angle), y - 0.5 - 0.25 * np.sin(angle)
    hot = np.exp(-(dx**2 + dy**2) / (2 * SIZE**2))
    moved = turn * (dy * np.cos(angle) - dx * np.sin(angle)) / SIZE**2
    return hot, hot * (moved - K * ((dx**2 + dy**2) / SIZE**4 - 2 / SIZE**2))


def warmed(mesh, before, t):
    """The temperature at the nodes after a step of the Crank-Nicolson method, to the time t."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=6)
    m, k = mass.assemble(basis), laplace.assemble(basis)
    x, y = basis.global_coordinates()
    source = 0.5 * (spot(t, x, y)[1] + spot(t - STEP, x, y)[1])
    load = skfem.LinearForm(lambda v, w: w.q * v).assemble(basis, q=source)
    right = m @ before.ravel() - 0.5 * STEP * K * (k @ before.ravel()) + STEP * load
    return skfem.solve(m + 0.5 * STEP * K * k, right).reshape(before.shape)


def error(mesh, temperature, t):
    """The error in the L2 norm."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1(), intorder=8)
    wrong = basis.interpolate(temperature.ravel()) - spot(t, *basis.global_coordinates())[0]
    return float(np.sqrt((wrong**2 * basis.dx).sum()))


def run(*, adapts):
    """The last mesh, the temperature on it, and its largest error at any time."""
    grid = em.Grid(n_xi=N, n_eta=N)
    mesh = em.Mesh.uniform(grid)
    first = em.LeastError(
        u=f"exp(-((x - 0.75)^2 + (y - 0.5)^2)/{2 * SIZE**2})", smoothness=100.0
    )  # smooth meshes carry best
    meshes = em.Sequence(em.Problem(monitor=first, grid=grid)) if adapts else None
    mesh = meshes.mesh if adapts else mesh
    temperature, worst = spot(0.0, mesh.x, mesh.y)[0], 0.0
    for t in STEP * np.arange(1, STEPS + 1):
        if adapts:  # the mesh of a step is for the temperature at its end, as the mesh before shows it
            there = warmed(mesh, temperature, t)
            step = meshes.step(there, {"T": em.MeshValues(temperature, transfer="conservative")})
            mesh, temperature = step.mesh, step.fields["T"]
        temperature = warmed(mesh, temperature, t)
        worst = max(worst, error(mesh, temperature, t))
    return mesh, temperature, worst


def main(output: Path) -> None:
    (mesh, temperature, adapted), (_, _, uniform) = run(adapts=True), run(adapts=False)
    print(f"largest L2 error: adapted {adapted:.2e}, uniform {uniform:.2e}, {uniform / adapted:.1f} times")
    figure = Figure(figsize=(5.4, 5.4), layout="constrained")
    axes = figure.add_subplot(title="the mesh behind the source", aspect="equal")
    axes.pcolormesh(mesh.x, mesh.y, temperature, shading="gouraud", cmap="inferno")
    axes.plot(mesh.x, mesh.y, mesh.x.T, mesh.y.T, color="white", linewidth=0.4)
    figure.savefig(output / "moving-heat-source.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
