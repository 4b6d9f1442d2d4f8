"""The equations of the interior nodes, without a matrix.

Newton's method solves its linear systems by GMRES. Products with the Jacobian are difference quotients of the defects.
The preconditioner is that of the sweeps, with the cross-line term: to leading order the first equation is

    2 P_xixi + eps (D / det)_mean P_etaeta = defect,    P = A dx + B dy,

and the second one is the same for ``Q = C dx + D dy``. With the mean of its coefficient over each line, a fast solver
by sines solves it. The number of products does not depend on the number of points.
"""

import math
from collections.abc import Callable

import numpy as np

from equimesh.equations.boundary import Boundary
from equimesh.equations.problem import Problem
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.gmres import gmres
from equimesh.numerics.sines import solve_by_sines, solve_lines
from equimesh.numerics.types import Array
from equimesh.sweeps.cell_metrics import cell_metrics
from equimesh.sweeps.defects import defects, directions

# The largest move of a node in a difference quotient, as a share of the spacing.
QUOTIENT_STEP = 1e-7
# Products with the Jacobian for one Newton step.
MAX_PRODUCTS = 20
# The residual of a linear system, relative to the first: between these, near the square of the last Newton reduction.
MAX_LINEAR_RESIDUAL, MIN_LINEAR_RESIDUAL = 0.3, 0.01
LINEAR_SHARE = 0.9


class Interior:
    """The requested equations at the interior nodes, or those with a cross-line term of weight ``cross_line``.

    ``vector`` and ``mesh`` lead from a mesh to the unknowns, which are x, then y, of the interior nodes, and back. The
    nodes on the sides stay where they are in ``start``; with orthogonal sides they follow the interior.
    """

    def __init__(self, problem: Problem, start: Mesh, cross_line: float) -> None:
        self._problem, self._start, self._cross_line = problem, start, cross_line
        n_xi, n_eta = problem.grid.shape
        self._shape, self._per_spacing = (n_xi - 2, n_eta - 2), (float((n_xi - 1) ** 2), float((n_eta - 1) ** 2))
        self._cells = np.empty((3, n_xi - 1, n_eta - 1))
        self._norms: list[float] = []

    @staticmethod
    def vector(mesh: Mesh) -> Array:
        """The unknowns of a mesh."""
        return np.concatenate([mesh.x[1:-1, 1:-1].ravel(), mesh.y[1:-1, 1:-1].ravel()])

    def mesh(self, z: Array) -> Mesh:
        """The mesh of the unknowns ``z``."""
        x, y = self._start.x.copy(), self._start.y.copy()
        x[1:-1, 1:-1], y[1:-1, 1:-1] = z.reshape(2, *self._shape)
        if self._problem.boundary is Boundary.ORTHOGONAL:
            for q in (x.T, y):
                q[0, 1:-1] = (4.0 * q[1, 1:-1] - q[2, 1:-1]) / 3.0
                q[-1, 1:-1] = (4.0 * q[-2, 1:-1] - q[-3, 1:-1]) / 3.0
        return Mesh(x, y)

    def is_valid(self, z: Array) -> bool:
        """Whether the mesh of ``z`` has no folds."""
        mesh = self.mesh(z)
        return smallest_jacobian(mesh.x, mesh.y) > 0.0

    def residual(self, z: Array, u: Array | None = None) -> Array:
        """The defects, an equation per unknown; dimensionless. ``u`` is given at all nodes where it is known."""
        mesh, out = self.mesh(z), np.empty((2, *self._shape))
        with np.errstate(all="ignore"):
            cell_metrics(self._problem.metric, mesh.x, mesh.y, self._cells, u)
            defects(mesh.x, mesh.y, self._cells, self._per_spacing, self._cross_line, out)
        return out.reshape(-1)

    @property
    def mean_flux(self) -> float:
        """The mean squared metric length of the coordinate directions in ``start``: the unit of the residual."""
        mesh, (m11, m12, m22) = self._start, self._cells
        cell_metrics(self._problem.metric, mesh.x, mesh.y, self._cells)
        means = []
        for axis, per_spacing in enumerate(self._per_spacing):
            dx, dy = np.diff(mesh.x, axis=axis), np.diff(mesh.y, axis=axis)
            for side in (slice(0, -1), slice(1, None)):
                ends = (slice(None), side) if axis == 0 else (side, slice(None))
                x, y = dx[ends], dy[ends]
                means.append(per_spacing * float(np.mean(m11 * x * x + 2.0 * m12 * x * y + m22 * y * y)))
        return sum(means) / len(means)

    def solver(self, z: Array) -> Callable[[Array], Array]:
        """A function that solves the linear system of Newton's method at ``z``, approximately."""
        there = _Linearised(self, z)
        return lambda right: gmres(
            there.product, there.precondition, right, tolerance=self._forcing(right), most=MAX_PRODUCTS
        )

    def _forcing(self, right: Array) -> float:
        """The accuracy of the linear system (Eisenstat and Walker 1996, their second choice)."""
        self._norms.append(float(np.abs(right).max()))
        if len(self._norms) == 1 or self._norms[-2] == 0.0:
            return MAX_LINEAR_RESIDUAL
        reduction = self._norms[-1] / self._norms[-2]
        return min(MAX_LINEAR_RESIDUAL, max(MIN_LINEAR_RESIDUAL, LINEAR_SHARE * reduction**2))


class _Linearised:
    """The Jacobian of the equations at one mesh: its products, and an approximate inverse."""

    def __init__(self, equations: Interior, z: Array) -> None:
        self._equations, self._z = equations, z
        self._value = equations.residual(z)
        self._shape, self._cross_line = equations._shape, equations._cross_line
        self._per_xi, self._per_eta = equations._per_spacing
        mesh, metric = equations.mesh(z), equations._problem.metric
        self._mesh, self._u = mesh, None if metric.arc_length is None else metric.u_with_gradient(mesh.x, mesh.y)
        found = np.empty((4, *self._shape))
        directions(mesh.x, mesh.y, equations._cells, found)
        self._a, self._b, self._c, self._d = found
        self._one_over = 1.0 / (self._a * self._d - self._b * self._c)
        if self._cross_line:
            self._across_p = self._cross_line * self._per_eta * (self._d * self._one_over).mean(axis=1)
            self._across_q = self._cross_line * self._per_xi * (self._a * self._one_over).mean(axis=0)

    def product(self, v: Array) -> Array:
        """The Jacobian times ``v``, by a difference quotient. The change of u is that of its tangent plane."""
        largest = float(np.abs(v).max())
        if not 0.0 < largest < math.inf:
            return np.zeros_like(v)
        step = QUOTIENT_STEP / (max(self._shape) + 1) / largest
        there = self._z + step * v
        if self._u is None:
            return np.asarray((self._equations.residual(there) - self._value) / step)
        u, u_x, u_y = self._u
        moved = self._equations.mesh(there)
        u = u + u_x * (moved.x - self._mesh.x) + u_y * (moved.y - self._mesh.y)
        return np.asarray((self._equations.residual(there, u) - self._value) / step)

    def precondition(self, r: Array) -> Array:
        """The change of the unknowns that removes the defects ``r``, to leading order."""
        first, second = r.reshape(2, *self._shape)
        if not self._cross_line:
            q = solve_lines(2.0 * self._per_eta, second.T).T
            p = solve_lines(2.0 * self._per_xi, first)
        else:
            q = solve_by_sines(2.0 * self._per_eta, self._across_q, np.ascontiguousarray(second.T)).T
            seen = np.zeros((self._shape[0], self._shape[1] + 2))
            seen[:, 1:-1] = self._b * self._one_over * q
            bent = seen[:, 2:] - 2.0 * seen[:, 1:-1] + seen[:, :-2]
            p = solve_by_sines(2.0 * self._per_xi, self._across_p, first + self._cross_line * self._per_eta * bent)
        change = np.stack([self._d * p - self._b * q, self._a * q - self._c * p]) * self._one_over
        return change.reshape(-1)
