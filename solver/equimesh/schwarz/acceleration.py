"""Acceleration of the iteration: none, Anderson's combination, or a Newton step for the fixed point."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy

from equimesh.meshes.mesh import Mesh
from equimesh.numerics import newton
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.line_corrections import CorrectionResult
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.settings import Acceleration, Schwarz
from equimesh.schwarz.subdomains import MergedSolutions, Subdomains

# Anderson acceleration of a fixed-point iteration for meshes.

# Iterations that are combined with the last one.
MAX_COMBINED = 5
# Singular values below this share of the largest count as zero: nearly equal changes add nothing.
MIN_SINGULAR_SHARE = 1e-12


class Anderson:
    """The combination of the last few results of an iteration whose changes nearly cancel (Anderson, type II)."""

    def __init__(self, merged: MergedMeshes, depth: int = MAX_COMBINED) -> None:
        self._merged, self._depth = merged, depth
        self._changes: deque[Mesh] = deque(maxlen=depth)
        self._results: deque[Mesh] = deque(maxlen=depth)
        self._last: tuple[Mesh, Mesh] | None = None

    def combine(self, start: Mesh, result: Mesh) -> Mesh | None:
        """A mesh nearer to the fixed point than ``result``, the result of one iteration from ``start``.

        ``None`` at the first call, where nothing changed, and where the combination would fold.
        """
        change = _minus(result, start)
        last, self._last = self._last, (change, result)
        if last is None:
            return None
        changes = [*self._changes, _minus(change, last[0])][-self._depth :]
        products = self._products(changes, change)
        if products is None:
            return None
        self._changes.append(changes[-1])
        self._results.append(_minus(result, last[1]))
        x, y = result.x.copy(), result.y.copy()
        for weight, moved in zip(_weights(*products), self._results, strict=True):
            x -= weight * moved.x
            y -= weight * moved.y
        combined = Mesh(x, y)
        return combined if self._merged.smallest_jacobian(combined) > 0.0 else None

    def _products(self, changes: Sequence[Mesh], change: Mesh) -> tuple[Array, Array] | None:
        """The inner products of the earlier changes with each other, and with the last one; ``None`` if one is zero."""
        count = len(changes)
        pairs = [(a, b) for a in changes for b in changes] + [(a, change) for a in changes]
        found = self._merged.products(pairs)
        return (found[:-count].reshape(count, count), found[-count:]) if found[-count - 1] > 0.0 else None


def _minus(one: Mesh, other: Mesh) -> Mesh:
    return Mesh(one.x - other.x, one.y - other.y)


def _weights(products: Array, against: Array) -> Array:
    """The least-squares weights of the earlier changes, by their normal equations scaled to unit length."""
    size = np.sqrt(np.diag(products))
    solution = np.linalg.lstsq(products / np.outer(size, size), against / size, rcond=MIN_SINGULAR_SHARE)[0]
    return np.asarray(solution / size)


# Newton's method for the fixed point of a parallel Schwarz iteration (RASPEN; Dolean, Gander, Kheriji, Kwok, Masson).
#
# One iteration maps a merged mesh ``z`` to another, ``G(z)``: every subdomain is solved with data from ``z``, and the
# result takes from each the nodes that it owns. Newton's method for ``G(z) = z`` solves ``(I - G'(z)) d = G(z) - z``.
# A product with ``G'(z)`` takes one solve with the factors of every subdomain's Jacobian, whose right side is the
# change of the subdomain's data.

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
                self._solvers[k] = newton.factorise(jacobian, equations.shape)

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

        operator = scipy.sparse.linalg.LinearOperator((change.size, change.size), matvec=product, dtype=np.float64)
        atol = accuracy * float(np.linalg.norm(change))
        step, _ = scipy.sparse.linalg.gmres(operator, change, atol=atol, restart=MAX_PRODUCTS, maxiter=1)
        return np.asarray(step)


def _vector(pair: Pair) -> Array:
    return np.concatenate([pair[0].ravel(), pair[1].ravel()])


def _pair(vector: Array, shape: tuple[int, ...]) -> Pair:
    x, y = vector.reshape(2, *shape)
    return x, y


# Largest deviation of a squared metric length from the mean of its line, as a share of the mean, near the solution.
# Farther away, earlier changes do not predict later ones.
MAX_LINEAR_DEVIATION = 0.1


@dataclass(frozen=True)
class AccelerationResult:
    """A mesh, and whether it is a combination. ``products`` counts products with the derivative of the iteration."""

    mesh: Mesh
    is_combined: bool = False
    products: int = 0


class Accelerator(Protocol):
    """Combines the results of several iterations to one mesh.

    With ``maps_merged_meshes`` the iteration must be a map of merged meshes: all data comes from one merged mesh.
    """

    maps_merged_meshes: bool

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The mesh to continue from, after an iteration that led from ``before`` to the ``corrected`` mesh.

        ``solved`` are its subdomains; errors of at most ``enough`` need no acceleration.
        """
        ...

    def forget(self) -> None:
        """Forget the iterations so far: later ones do not continue them."""
        ...


def accelerator(
    settings: Schwarz, merged: MergedMeshes, subdomains: Callable[[], Subdomains], rounding: float, threads: int
) -> Accelerator:
    """The accelerator of the settings; ``subdomains`` returns all of them, with whole meshes."""
    if settings.accelerated_by is Acceleration.NEWTON:
        return NewtonAccelerator(merged, lambda: Raspen(subdomains(), rounding, threads))
    return AndersonAccelerator(merged) if settings.accelerated_by is Acceleration.ANDERSON else NoAcceleration()


class NoAcceleration:
    """No acceleration."""

    maps_merged_meshes = False

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The corrected mesh."""
        del before, solved, enough
        return AccelerationResult(corrected.mesh)

    def forget(self) -> None:
        """Nothing is remembered."""


class AndersonAccelerator:
    """Anderson's combination, near the solution and while it is needed."""

    maps_merged_meshes = False

    def __init__(self, merged: MergedMeshes) -> None:
        self._merged = merged
        self._anderson = Anderson(merged)

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The combination, or the corrected mesh where there is none."""
        del solved
        if corrected.estimate <= enough or corrected.deviation > MAX_LINEAR_DEVIATION:
            return AccelerationResult(corrected.mesh)
        combined = self._anderson.combine(before, corrected.mesh)
        return (
            AccelerationResult(corrected.mesh) if combined is None else AccelerationResult(combined, is_combined=True)
        )

    def forget(self) -> None:
        """Forget all iterations."""
        self._anderson = Anderson(self._merged)


class NewtonAccelerator:
    """Newton steps for the fixed point, where all subdomains were solved with the requested condition."""

    maps_merged_meshes = True

    def __init__(self, merged: MergedMeshes, raspen: Callable[[], Raspen]) -> None:
        self._merged, self._make = merged, raspen

    @cached_property
    def _raspen(self) -> Raspen:
        return self._make()

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The mesh after a Newton step, or the corrected mesh where there is none."""
        del enough
        if solved.has_stalled or solved.is_rescued:
            return AccelerationResult(corrected.mesh)
        combined, products = self._merged.on_whole(self._step, [before, corrected.mesh], solved.states)
        if combined is None:
            return AccelerationResult(corrected.mesh, products=int(products))
        return AccelerationResult(combined, is_combined=True, products=int(products))

    def _step(self, meshes: Sequence[Mesh], states: Sequence[Mesh]) -> tuple[Mesh | None, float]:
        """The mesh after a Newton step, and the number of products."""
        combined = self._raspen.combine(meshes[0], meshes[1], states)
        return combined, float(self._raspen.products)

    def forget(self) -> None:
        """Nothing is remembered."""
