"""Newton's method for the fixed point of a parallel Schwarz iteration (RASPEN; Dolean, Gander, Kheriji, Kwok, Masson).

One iteration maps a merged mesh ``z`` to another, ``G(z)``: every subdomain is solved with data from ``z``, and the
result takes from each the nodes that it owns. Newton's method for ``G(z) = z`` solves ``(I - G'(z)) d = G(z) - z``. A
product with ``G'(z)`` takes one solve with the factors of every subdomain's Jacobian, whose right side is the change of
the subdomain's data.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from equimesh.meshes.mesh import Mesh
from equimesh.numerics import dissection
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.port import Subdomains

# Products with the derivative of the iteration in one Newton step.
MAX_PRODUCTS = 50
# Limits of the relative error of a step. Between them it equals the change, for quadratic convergence. The lower one is
# the default of SciPy in all versions.
MAX_STEP_ERROR = 1e-2
MIN_STEP_ERROR = 1e-5
# A step that would fold the mesh is halved down to this share.
MIN_STEP_SHARE = 1 / 16


class Slope:
    """``G'(z)`` at a mesh ``z``, from which the subdomains have the solutions ``states``.

    Raises ``RuntimeError`` where a subdomain's Jacobian is singular.
    """

    def __init__(self, subdomains: Subdomains, mesh: Mesh, states: Sequence[Mesh], threads: int = 1) -> None:
        subdomains.restart(mesh)
        subdomains.begin(mesh)
        self._windows, self._slopes = subdomains.windows, subdomains.slopes(states)
        self._solvers: dict[int, Callable[[Array], Array]] = {}

        def factorise(worker: int) -> None:
            for k in range(worker, len(states), threads):
                equations = subdomains.equations(k)
                jacobian = equations.jacobian(equations.vector(states[k]))
                self._solvers[k] = dissection.factorise(jacobian, equations.shape)

        run_on_threads(threads, factorise)

    def __call__(self, change: Pair) -> Pair:
        """The change of ``G(z)``, when the nodes of ``z`` move by ``change``."""
        found = Mesh(np.zeros_like(change[0]), np.zeros_like(change[1]))
        for k, right in enumerate(self._slopes.received(change)):
            window = self._windows[k]
            x, y = self._solvers[k](right).reshape(2, *window.shape)
            window.write(Mesh(x, y), found, window.part.owned)
        return found.x, found.y


class Raspen:
    """Newton steps for the fixed point; ``products`` counts the products with ``G'`` in the last step."""

    def __init__(self, subdomains: Subdomains, rounding: float, threads: int = 1) -> None:
        self._subdomains, self._rounding, self._threads = subdomains, rounding, threads
        self.products = 0

    def combine(self, start: Mesh, result: Mesh, states: Sequence[Mesh]) -> Mesh | None:
        """The mesh after a Newton step from ``start``, from which one iteration led to ``states`` and ``result``.

        ``None`` where the iteration has converged to rounding, and where every share of the step would fold.
        """
        self.products = 0
        change = _vector((result.x, result.y)) - _vector((start.x, start.y))
        size = float(np.abs(change).max())
        if size <= self._rounding:
            return None
        try:
            slope = Slope(self._subdomains, start, states, self._threads)
        except RuntimeError:  # SuperLU: a matrix is exactly singular
            return None
        step = self._step(slope, change, min(MAX_STEP_ERROR, max(MIN_STEP_ERROR, size)), start.x.shape)
        share = 1.0
        while share >= MIN_STEP_SHARE:
            x, y = _pair(_vector((start.x, start.y)) + share * step, start.x.shape)
            moved = Mesh.of_unit_square(x, y)
            if not moved.is_folded:
                return moved
            share /= 2
        return None

    def _step(self, slope: Slope, change: Array, accuracy: float, shape: tuple[int, ...]) -> Array:
        def product(v: Array) -> Array:
            self.products += 1
            return np.asarray(v - _vector(slope(_pair(v, shape))))

        operator = LinearOperator((change.size, change.size), matvec=product, dtype=np.float64)
        atol = accuracy * float(np.linalg.norm(change))
        step, _ = gmres(operator, change, atol=atol, restart=MAX_PRODUCTS, maxiter=1)
        return np.asarray(step)


def _vector(pair: Pair) -> Array:
    return np.concatenate([pair[0].ravel(), pair[1].ravel()])


def _pair(vector: Array, shape: tuple[int, ...]) -> Pair:
    x, y = vector.reshape(2, *shape)
    return x, y
