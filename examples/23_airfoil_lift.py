"""Lift of an airfoil: potential flow past NACA 0012 at 8 degrees with scikit-fem, on an O-grid that follows the speed.

The stream function psi solves Laplace's equation and is constant on the airfoil. Kutta's condition fixes this
constant: the flow does not turn around the trailing edge. The lift is twice the flux of grad(psi) out of the airfoil.

    pip install 'equimesh[solver,plot]' scikit-fem
    python 23_airfoil_lift.py
"""

import argparse
from pathlib import Path

import numpy as np
import skfem
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from skfem.models.poisson import laplace, mass

import equimesh as em

ANGLE = np.radians(8)
FINE, ROUNDS = 4, 2  # the reference has 16 times the cells
BEHIND = np.array([0.02, 0.04])  # distances from the trailing edge where Kutta's condition is held
SLOPE = 0.6 * (0.2969 / 2 - 0.126 - 2 * 0.3516 + 3 * 0.2843 - 4 * 0.1036)  # of the upper side at this edge
POWER = np.pi / (2 * (np.pi + np.arctan(SLOPE)))  # psi = K r^POWER + L r^(3 POWER) straight behind the edge


def airfoil(refine: float = 1) -> em.Blocks:
    """A circle of eight chords around the airfoil: one closed block, whose cells grow from the airfoil on."""
    return em.Blocks.of(
        {
            "vertices": {"te": [1, 0], "far": [8.5, 0]},
            "curves": {"foil": {"naca": "0012"}, "far": {"circle": {"center": [0.5, 0], "radius": 8}}},
            "edges": [
                {"from": "te", "to": "te", "on": "foil", "grading": 1},
                {"from": "far", "to": "far", "on": "far", "grading": 1},
            ],
            "blocks": [{"corners": ["te", "far", "far", "te"], "cells": [32, 96], "grading": [60, None]}],
            "sides": {"foil": [["te", "te"]], "far": [["far", "far"]]},
            "refine": refine,
        }
    )


def flow(mesh: em.Mesh) -> tuple[np.ndarray, np.ndarray, float]:
    """psi and the speed at the nodes, and the lift coefficient."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1())
    matrix = laplace.assemble(basis)
    foil, far = (np.unique(mesh.sides[name]) for name in ("foil", "far"))
    x, y = mesh.points.T
    stream, turning = x * np.sin(ANGLE) - y * np.cos(ANGLE), np.zeros(len(x))
    stream[foil], turning[foil] = 0, 1  # a stream past the airfoil, and a flow around it alone
    sides = np.concatenate([foil, far])
    stream, turning = (skfem.solve(*skfem.condense(matrix, x=given, D=sides)) for given in (stream, turning))
    psi = stream - around_the_edge(mesh, stream) / around_the_edge(mesh, turning) * turning
    areas = mass.assemble(basis) @ np.ones(len(x))
    slopes = basis.interpolate(psi).grad
    mean = skfem.LinearForm(lambda v, at: at.slope * v)
    speed = np.hypot(*(mean.assemble(basis, slope=slope) / areas for slope in slopes))
    return psi, speed, 2 * float(turning @ (matrix @ psi))


def around_the_edge(mesh: em.Mesh, values: np.ndarray) -> float:
    """K of ``values`` behind the trailing edge."""
    found = em.QuadField(mesh=mesh, values=values).evaluate(1 + BEHIND, 0 * BEHIND)[0]
    near = (found - values[mesh.sides["foil"][0, 0]]) / BEHIND**POWER
    first, second = BEHIND ** (2 * POWER)
    return float((near[0] * second - near[1] * first) / (second - first))


def velocity_error(mesh: em.Mesh, psi: np.ndarray, exact: em.QuadField) -> float:
    """The L2 error of the velocity, which is the gradient of psi turned by a right angle."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=5)
    _, *slopes = exact.evaluate(*basis.global_coordinates(), order=1)
    found = basis.interpolate(psi).grad
    return float(np.sqrt(sum(((found[k] - slopes[k]) ** 2 * basis.dx).sum() for k in (0, 1))))


def draw(meshes: list[em.Mesh], path: Path) -> None:
    figure = Figure(figsize=(10, 5.1), layout="constrained")
    for axes, mesh, title in zip(figure.subplots(1, 2), meshes, ("initial", "adapted to the speed"), strict=True):
        axes.add_collection(PolyCollection(mesh.points[mesh.cells], facecolor="none", edgecolor="0.2", linewidth=0.4))
        axes.set(title=title, aspect="equal", xlim=(-0.15, 0.35), ylim=(-0.25, 0.25))
    figure.savefig(path, dpi=100)


def main(output: Path) -> None:
    domain, fine = airfoil(), airfoil(FINE).mesh
    psi, _, lift = flow(fine)
    exact = em.QuadField(mesh=fine, values=psi, limited=False)
    print(f"reference of {len(fine.cells)} cells: lift {lift:.5f}")

    def say(name: str, mesh: em.Mesh) -> np.ndarray:
        found, speed, near = flow(mesh)
        error = velocity_error(mesh, found, exact)
        print(f"{name}: {len(mesh.cells)} cells, lift {near - lift:+.1e}, velocity {error:.2e}")
        return speed

    mesh = domain.mesh
    finer = airfoil(2).mesh
    say("four times the cells", finer)
    speed = say("initial", mesh)
    for number in range(1, ROUNDS + 1):
        monitor = em.LeastError(u=em.QuadField(mesh=mesh, values=speed), distortion=4, smoothness=30)
        mesh = em.solve(em.Problem(monitor=monitor, domain=domain), initial=mesh, check=False).mesh
        speed = say(f"round {number}", mesh)
    draw([domain.mesh, mesh], output / "airfoil.png")
    print(f"wrote {output / 'airfoil.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
