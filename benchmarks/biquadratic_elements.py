"""Biquadratic elements of scikit-fem for the problems of `refinement.py`: the values, and their errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import skfem
from scipy.sparse.linalg import splu
from skfem.helpers import dot, grad

import equimesh as em

if TYPE_CHECKING:
    from refinement import Problem

SOLVE_POINTS, ERROR_POINTS = 7, 13
"""Gauss points a direction and cell of matrices and loads, and of errors."""
NEWTON_STEPS = 12
"""Steps, at most, for an equation that is not linear."""


@dataclass(frozen=True)
class BiquadraticElements:
    """A mesh, and the equation of ``problem`` on it; all nodes on the sides are fixed."""

    problem: Problem
    mesh: skfem.MeshQuad

    @classmethod
    def of(cls, problem: Problem, mesh: em.Mesh) -> BiquadraticElements:
        """The elements of a mesh of a grid or of blocks."""
        return cls(problem, mesh.to_skfem())

    @property
    def unknowns(self) -> int:
        """The number of free unknowns."""
        return len(self._free(self._basis(SOLVE_POINTS)))

    def returned(self, values: np.ndarray) -> tuple[skfem.Basis, np.ndarray]:
        """What a solver returns to `em.adapt`."""
        return self._basis(SOLVE_POINTS), values

    def solve(self) -> np.ndarray:
        """The values at the nodes of the elements."""
        basis, problem, u = self._basis(SOLVE_POINTS), self.problem, em.Expression(self.problem.u)
        free, given = self._free(basis), _fields(u, basis)
        values = u.evaluate(*basis.doflocs)[0]
        if problem.is_nonlinear:
            values[free] = 0.0
        for _ in range(NEWTON_STEPS if problem.is_nonlinear else 1):
            here = basis.interpolate(values)
            matrix = skfem.BilinearForm(self._derivative).assemble(basis, here=here)
            rest = skfem.LinearForm(self._rest).assemble(basis, here=here, **given)
            step = splu(matrix[free][:, free].tocsc()).solve(rest[free])
            values[free] += step
            if np.abs(step).max() <= 1e-10 * np.abs(values).max():
                break
        return values

    def errors(self, values: np.ndarray) -> tuple[float, float]:
        """The relative errors of a vector in L2 and in the full H1 norm."""
        basis = self._basis(ERROR_POINTS)
        here, given = basis.interpolate(values), _fields(em.Expression(self.problem.u), basis)
        exact, x, y = given.values()
        squares = (exact - here) ** 2, (x - here.grad[0]) ** 2 + (y - here.grad[1]) ** 2, exact**2, x**2 + y**2
        value, slope, whole, whole_slope = (float((part * basis.dx).sum()) for part in squares)
        return math.sqrt(value / whole), math.sqrt((value + slope) / (whole + whole_slope))

    def _basis(self, points: int) -> skfem.Basis:
        """The basis with a Gauss rule, which crowds to x = 0 as the problem says."""
        at, w = np.polynomial.legendre.leggauss(points)
        at, w, power = 0.5 * (at + 1.0), 0.5 * w, self.problem.power
        places = np.stack([part.ravel() for part in np.meshgrid(at**power, at, indexing="ij")])
        weights = np.outer(power * at ** (power - 1) * w, w).ravel()
        return skfem.Basis(self.mesh, skfem.ElementQuad2(), quadrature=(places, weights))

    @staticmethod
    def _free(basis: skfem.Basis) -> np.ndarray:
        return np.setdiff1d(np.arange(basis.N), basis.get_dofs().all())

    def _derivative(self, v: Any, w: Any, at: Any) -> Any:
        problem, b = self.problem, self.problem.stream
        a = 1.0 + at.here**2 if problem.is_nonlinear else problem.diffusion
        form = a * dot(grad(v), grad(w)) + (problem.reaction * v + b[0] * grad(v)[0] + b[1] * grad(v)[1]) * w
        return form + 2.0 * at.here * v * dot(grad(at.here), grad(w)) if problem.is_nonlinear else form

    def _rest(self, w: Any, at: Any) -> Any:
        problem, b, slope = self.problem, self.problem.stream, grad(at.here)
        a, exact = problem.diffusion, problem.diffusion
        if problem.is_nonlinear:
            a, exact = 1.0 + at.here**2, 1.0 + at.u**2
        fluxes = (exact * at.x_ - a * slope[0]) * grad(w)[0] + (exact * at.y_ - a * slope[1]) * grad(w)[1]
        other = problem.reaction * (at.u - at.here) + b[0] * (at.x_ - slope[0]) + b[1] * (at.y_ - slope[1])
        return fluxes + other * w


def _fields(u: em.Expression, basis: skfem.Basis) -> dict[str, np.ndarray]:
    """The exact values and gradients at the points of the quadrature."""
    return dict(zip(("u", "x_", "y_"), u.evaluate(*basis.global_coordinates(), order=1), strict=True))
