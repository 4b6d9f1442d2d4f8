"""Adapting to a functional with u unknown: its error, and the estimate of that, on the mesh of every round.

    python benchmarks/goals.py                     all problems: three minutes
    python benchmarks/goals.py --only point disc
    python benchmarks/goals.py --own               estimates from recovered u and z, without the right side

*point* and *between* are step-14 of deal.II: -Laplace(u) = 1 on the square from -1 to 1 without that of half its size,
u = 0, and the value at (0.75, 0.75), a node of the first mesh or a point in a cell. *disc* and *disc aside* are the
point discharge of TELEMAC: a stream along a basin with a narrow source, and the integrals over two discs downstream.

*corner* are three functionals of the same equation on an L, *round* is a point in the unit disc.

Measured on the returned meshes, at most five rounds: *point*, 3952 unknowns, error 6.9e-6, refinement 1.6e-5 (3975
unknowns); *between*, 3811 unknowns, 7e-7; the discs 2.9e-5 and 1.0e-5. Corrected values have errors of 1.0e-7, 1.3e-7,
4.2e-7 and 4.9e-7. The effectivity is 0.99, 0.81, 0.99 and 1.05, on the other four problems 1.00 (mean), 1.01 (point),
1.01 (flux) and 1.00. The error of *between* is 2 % of the sum of the products, by chance: parts of both signs cancel,
and the estimate has nothing but what is left. On cells that are not halved the solution of degree 2 lacks 4.4e-7 there.
Rounds are ranked by that sum. That of *disc* is as much of chance: with u wrong by 1e-12 the best mesh has an error of
5.5e-5, in place of 2.9e-5.

*lift* is that of the airfoil of example 23, by Kutta's condition, whose errors have both signs, too. The bound falls by
18 in five rounds, and the error from 3.0e-3 to 5.4e-4, whose estimate, -2.4e-4, has the wrong sign: it is that of the
elements on a polygon, -5.5e-4. By elements of degree 2 on the same cells cut into 16 this polygon has 1.1e-3 less lift
than the profile, which the estimate does not see.
"""

from __future__ import annotations

import argparse
import runpy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from skfem.helpers import dot, grad

import equimesh as em
from equimesh.testing.geometries import disc, l_shape

POINT = (0.75, 0.75)
POINT_VALUE = 0.03344723
"""By elements of degree 7 on a mesh that is graded to all corners; https://www.dealii.org/current/doxygen/deal.II/step_14.html
has it to 1e-7."""
REFINED = {"unknowns": 3975, "error": 1.6e-5}
"""Dual weighted refinement there, about as many unknowns."""
COUNTS = {"point": (12, 12, 20, 28), "between": (12, 12, 20, 27)}
"""Cells of the columns and rows of blocks: where z is small, along both halves of the hole, and around the point."""
GRADING = (10, 10, 3)
"""The longest cell of these columns over the shortest one, which is at the next corner of the hole."""
SOURCE, RADIUS, SPREAD = (2.0, 5.0), 0.05606388, 0.1
"""The place and the radius of the source, and the diffusion of the discharge."""
DISCS = {"disc": ((20.0, 5.0), 0.16141025), "disc aside": ((20.0, 7.5), 0.06884777)}
"""Centres, and the integrals over the discs of radius 0.5, by elements of degree 6 on a mesh graded to the source."""
LOAD_POINTS = 12


def ring(counts: tuple[int, int, int, int]) -> em.Blocks:
    """The square with a hole, in twelve blocks with ``counts`` of cells, which get smaller to corners of the hole."""
    lines, (first, middle, last) = (-1.0, -0.5, 0.0, 0.5, 1.0), GRADING
    gradings = (1.0 / first, middle, 1.0 / middle, last)
    places = [(i, j) for i in range(4) for j in range(4) if not {i, j} <= {1, 2}]
    blocks = [
        {
            "corners": [f"{i}{j}", f"{i + 1}{j}", f"{i + 1}{j + 1}", f"{i}{j + 1}"],
            "cells": [counts[i], counts[j]],
            "grading": [gradings[i], gradings[j]],
        }
        for i, j in places
    ]
    names = {name for block in blocks for name in block["corners"]}
    vertices = {name: [lines[int(name[0])], lines[int(name[1])]] for name in sorted(names)}
    return em.Blocks.of({"vertices": vertices, "blocks": blocks})


@dataclass(frozen=True)
class Equation:
    """``-diffusion Laplace(u) + stream u_x = f``."""

    diffusion: float = 1.0
    stream: float = 0.0
    fixed: tuple[str, ...] = ()
    """Sides with u = 0; all without a name."""

    def source(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """f."""
        if not self.stream:
            return np.ones_like(x)
        return 100.0 * np.exp(-((x - SOURCE[0]) ** 2 + (y - SOURCE[1]) ** 2) / RADIUS**2)

    def assembled(self, basis: skfem.Basis, tau: np.ndarray | float) -> tuple[Any, np.ndarray, np.ndarray]:
        """Matrix, load and the nodes with given values; with ``tau`` of the cells SUPG."""

        def form(u: Any, v: Any, w: Any) -> Any:
            along = self.stream * grad(u)[0]
            return self.diffusion * dot(grad(u), grad(v)) + along * (v + w.tau * self.stream * grad(v)[0])

        def load(v: Any, w: Any) -> Any:
            return self.source(*w.x) * (v + w.tau * self.stream * grad(v)[0])

        rule = skfem.Basis(basis.mesh, basis.elem, intorder=2 * LOAD_POINTS - 1) if self.stream else basis
        matrix = skfem.BilinearForm(form).assemble(basis, tau=np.broadcast_to(tau, basis.dx.shape))
        right = skfem.LinearForm(load).assemble(rule, tau=np.broadcast_to(tau, rule.dx.shape))
        return matrix, right, basis.get_dofs(list(self.fixed) or None).all()

    def parameter(self, mesh: em.Mesh) -> np.ndarray | float:
        """The SUPG parameter of each cell, bounded by its thickness."""
        if not self.stream:
            return 0.0
        corners = mesh.points[mesh.cells]
        a = 0.5 * (corners[:, 1] + corners[:, 2] - corners[:, 0] - corners[:, 3])
        b = 0.5 * (corners[:, 2] + corners[:, 3] - corners[:, 0] - corners[:, 1])
        thickness = np.linalg.svd(np.stack([a, b], axis=1), compute_uv=False)[:, -1]
        length = np.ptp(corners[..., 0], axis=1)
        peclet = self.stream * length / (2.0 * self.diffusion)
        tau = length / (2.0 * self.stream) * (1.0 / np.tanh(peclet) - 1.0 / peclet)
        return np.minimum(tau, thickness**2 / (12.0 * self.diffusion))[:, None]


@dataclass(frozen=True)
class Problem:
    """A functional of the solution of an equation."""

    equation: Equation
    goal: em.Goal
    exact: float
    domain: Any
    points: tuple[int, int] | None = None
    """Points of the grid; ``None`` on blocks."""

    def solve(self, mesh: em.Mesh) -> em.WithAdjoint:
        """Bilinear elements."""
        equation, of = self.equation, mesh.to_skfem()
        basis = skfem.Basis(of, skfem.ElementQuad1(), intorder=4)
        matrix, load, fixed = equation.assembled(basis, equation.parameter(mesh))
        u = skfem.solve(*skfem.condense(matrix, load, D=fixed))
        return em.WithAdjoint(u, matrix=matrix, fixed=fixed, load=load)


def in_disc(centre: tuple[float, float]) -> Any:
    """The region of a disc of radius 0.5."""
    return lambda x, y: np.hypot(x - centre[0], y - centre[1]) < 0.5


def in_corner(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A rectangle of the L."""
    return (x < -0.5) & (y < -0.25)


POISSON = Equation()
L_SHAPE = l_shape(900)
DISCHARGE = Equation(diffusion=SPREAD, stream=1.0, fixed=("left",))
BASIN = em.Rectangle(x=(0.0, 50.0), y=(0.0, 10.0))
PROBLEMS = {
    **{
        name: Problem(POISSON, em.Goal.point(*POINT, diffusion=1.0, source=1.0), POINT_VALUE, ring(counts))
        for name, counts in COUNTS.items()
    },
    **{
        name: Problem(
            DISCHARGE,
            em.Goal.integral(in_disc(centre), diffusion=SPREAD, stream=(1.0, 0.0), source=DISCHARGE.source),
            value,
            BASIN,
            (129, 33),
        )
        for name, (centre, value) in DISCS.items()
    },
    "corner mean": Problem(POISSON, em.Goal.integral(in_corner, diffusion=1.0, source=1.0), 0.0200405654, L_SHAPE),
    "corner point": Problem(POISSON, em.Goal.point(0.3, 0.6, diffusion=1.0, source=1.0), 0.112905261, L_SHAPE),
    "corner flux": Problem(POISSON, em.Goal.flux("reentrant", diffusion=1.0, source=1.0), -0.87436, L_SHAPE),
    "round": Problem(POISSON, em.Goal.point(0.2, 0.3, diffusion=1.0, source=1.0), 0.25 * (1.0 - 0.13), disc(900)),
}

NAMES = [*PROBLEMS, "lift"]


def rows(name: str, rounds: int, *, is_own: bool) -> Iterator[str]:
    """The rounds of a problem: errors of the value and of the corrected one, and what was estimated over the error."""
    problem = PROBLEMS[name]
    goal = replace(problem.goal, source=None) if is_own else problem.goal
    arguments: dict[str, Any] = {"domain": problem.domain, "goal": goal, "rounds": rounds}
    if problem.points is not None:
        arguments["n"] = problem.points
    found = em.adapt(problem.solve, **arguments)
    yield from told(name, found, problem.exact)


# Lift of an airfoil, whose circulation follows from Kutta's condition.

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "23_airfoil_lift.py"


def lift(mesh: em.Mesh, foil: dict[str, Any]) -> em.WithAdjoint:
    """The stream function, the lift, and its adjoint: that of the flux, and of the value K behind the trailing edge."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1())
    matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    (x, y), angle = mesh.points.T, foil["ANGLE"]
    stream, turning = x * np.sin(angle) - y * np.cos(angle), np.zeros(len(x))
    on_foil, far = (np.unique(mesh.sides[name]) for name in ("foil", "far"))
    stream[on_foil], turning[on_foil], fixed = 0.0, 1.0, np.concatenate([on_foil, far])
    stream, turning = (skfem.solve(*skfem.condense(matrix, x=given, D=fixed)) for given in (stream, turning))
    edge, distances, power = np.zeros(len(x)), foil["BEHIND"], foil["POWER"]
    edge[mesh.sides["foil"][0, 0]] = 1.0
    near = [(em.Goal.point(1.0 + at, 0.0).on(mesh) - edge) / at**power for at in distances]
    first, second = distances ** (2 * power)
    behind = (near[0] * second - near[1] * first) / (second - first)
    psi = stream - (behind @ stream) / (behind @ turning) * turning
    factor = 2.0 * float(turning @ (matrix @ turning)) / float(behind @ turning)
    z = skfem.solve(*skfem.condense(matrix, behind, D=fixed))
    return em.WithAdjoint(psi, -2.0 * turning - factor * z, value=2.0 * float(turning @ (matrix @ psi)))


def lift_rows(rounds: int) -> Iterator[str]:
    """The rounds of the lift, against that on 16 times the cells."""
    foil = runpy.run_path(str(EXAMPLE))
    exact = lift(foil["airfoil"](foil["FINE"]).mesh, foil).value or 0.0
    goal = em.Goal(lambda mesh: np.ones(len(mesh.points)), diffusion=1.0)
    found = em.adapt(lambda mesh: lift(mesh, foil), domain=foil["airfoil"](), goal=goal, rounds=rounds)
    yield from told("lift", found, exact)


def told(name: str, found: em.Adaptation[em.Mesh], exact: float) -> Iterator[str]:
    """What happened in every round."""
    for one in found.rounds:
        if one.goal is None:
            raise RuntimeError("a round has no functional")
        error, rest = exact - one.goal.value, exact - one.goal.corrected
        known = "unknown" if one.goal.error is None else f"{one.goal.error / error:.2f}"
        mark = "*" if one.number == found.best else " "
        yield (
            f"{name}{mark} {one.number}: {len(one.mesh.points)} nodes, error {error:.2e}, corrected {rest:.2e},"
            f" effectivity {known}, bound {one.goal.bound:.1e},"
            f" unresolved {one.unresolved:.3f}, {one.start}"
        )
    yield f"    {found.reason}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES, help="these problems")
    parser.add_argument("--rounds", type=int, default=5, help="rounds, at most")
    parser.add_argument("--own", action="store_true", help="estimates from recovered u and z, none for points")
    options = parser.parse_args()
    for name in options.only:
        is_lift = name == "lift"
        for row in lift_rows(options.rounds) if is_lift else rows(name, options.rounds, is_own=options.own):
            print(row, flush=True)


if __name__ == "__main__":
    main()
