"""A circle that shrinks by its curvature: 500 steps of the Allen-Cahn equation, by scikit-fem on moving meshes.

u_t = Laplace u - (u**3 - u) / eps**2 in the unit square, for a quarter of a circle of radius r around a corner. For
small eps its front moves at the speed 1 / r, so that r**2 falls by 2 in a unit of time. On a uniform mesh whose cells
are wider than the front it stands almost still.

    pip install 'equimesh[solver,plot]' scikit-fem && python 20_allen_cahn.py
"""

import argparse
import logging
from pathlib import Path

import numpy as np
import skfem
from matplotlib.figure import Figure
from scipy.sparse import diags
from scipy.sparse.linalg import spsolve
from skfem.models.poisson import laplace, mass

import equimesh as em

N, STEPS, DT, EPS, RADIUS = 33, 500, 1e-4, 0.02, 0.75
START = em.Expression("tanh((0.75 - hypot(x, y)) / (sqrt(2)*0.02))")

logging.getLogger("skfem").setLevel(logging.ERROR)


def advanced(mesh, u):
    """u after a time step: implicit Euler with one step of Newton's method."""
    basis = skfem.Basis(skfem.MeshQuad(mesh.points.T.copy(), mesh.cells.T.copy()), skfem.ElementQuad1())
    stiffness, masses, v = laplace.assemble(basis), mass.assemble(basis), u.ravel()
    weights = np.asarray(masses.sum(axis=1)).ravel()
    matrix = masses / DT + stiffness + diags(weights * (3 * v**2 - 1) / EPS**2)
    return spsolve(matrix.tocsc(), masses @ v / DT + 2 * weights * v**3 / EPS**2).reshape(u.shape)


def radius(mesh, u):
    """The radius of a quarter of a disc with the area where u is 1."""
    return np.sqrt(4 / np.pi * em.integral(mesh, 0.5 * (1 + u)))


def run(steps, transfer=None, n=N):
    """Mesh and u at the start and after each step; on the uniform mesh without a ``transfer``."""
    grid = em.Grid(n_xi=n, n_eta=n)
    problem = em.Problem(monitor=em.ArcLength(u=START), grid=grid)
    meshes = em.Sequence(problem, mesh=None if transfer else em.Mesh.uniform(grid))
    mesh, u = meshes.mesh, START.evaluate(meshes.mesh.x, meshes.mesh.y)[0]
    yield mesh, u
    for _ in range(steps):
        u = advanced(mesh, u)
        if transfer:
            step = meshes.step(u, {"u": em.MeshValues(u, transfer=transfer)})
            mesh, u = step.mesh, step.fields["u"]
        yield mesh, u


def main(output: Path) -> None:
    exact = np.sqrt(RADIUS**2 - 2 * DT * np.arange(STEPS + 1))
    figure = Figure(figsize=(9, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(exact, "k--", label="theory")
    for name, transfer in (
        ("uniform mesh", None),
        ("moving, spline", "spline"),
        ("moving, conservative", "conservative"),
    ):
        states = list(run(STEPS, transfer))
        radii = [radius(*state) for state in states]
        print(f"{name}: radius {radii[-1]:.5f}, theory {exact[-1]:.5f}, largest |u| {abs(states[-1][1]).max():.6f}")
        left.plot(radii, label=name)
    mesh, u = states[-1]
    left.set(xlabel="steps", title="radius")
    left.legend()
    right.contour(mesh.x, mesh.y, u, levels=[-0.9, 0.0, 0.9], colors="tab:red")
    right.plot(mesh.x, mesh.y, mesh.x.T, mesh.y.T, color="black", linewidth=0.3)
    right.set(title=f"after {STEPS} steps", aspect="equal")
    figure.savefig(output / "allen-cahn.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
