"""Fields with their gradients, and meshes made by hand, of which the quality is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import equimesh as em
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.quality.measures import measure_errors

Partial = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Analytic:
    """A field given by its value and gradient."""

    value: Partial
    along_x: Partial
    along_y: Partial

    def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
        parts = (self.value, self.along_x, self.along_y)[: 1 if order == 0 else 3]
        return tuple(part(x, y) for part in parts)


PAPER = Analytic(
    lambda x, y: (1 - np.exp(15 * (x - 1))) * np.sin(np.pi * y),
    lambda x, y: -15 * np.exp(15 * (x - 1)) * np.sin(np.pi * y),
    lambda x, y: (1 - np.exp(15 * (x - 1))) * np.pi * np.cos(np.pi * y),
)


def constant(value: float) -> Partial:
    return lambda x, y: np.full(np.broadcast_shapes(x.shape, y.shape), value)


TANH20 = em.Expression("tanh(20*(x + y/2 - 0.75))")


ERRORS = ("l2", "l2_uniform", "h1", "h1_uniform")


CONSTANT = Analytic(constant(3.0), constant(0.0), constant(0.0))


SLOPE = Analytic(lambda x, y: 2 * x + 0 * y, constant(2.0), constant(0.0))


CUBIC_Y = Analytic(lambda x, y: 0 * x + y**3, constant(0.0), lambda x, y: 3 * y**2 + 0 * x)


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def uniform(n_xi: int, n_eta: int | None = None) -> Mesh:
    return Mesh.uniform(Grid(n_xi=n_xi, n_eta=n_eta or n_xi))


def wavy(n_xi: int = 13, n_eta: int = 9) -> Mesh:
    """A smooth valid mesh without any symmetry."""
    start = uniform(n_xi, n_eta)
    x, y = start.x, start.y
    bump = np.sin(np.pi * x) * np.sin(np.pi * y)
    return Mesh(x + 0.1 * bump * (1 + y) + 0.05 * x * (1 - x), y - 0.08 * bump * (2 - x))


def folded() -> Mesh:
    """A uniform mesh with one inner node moved across the next line."""
    mesh = uniform(6)
    x = mesh.x.copy()
    x[2, 2] = 0.75
    return Mesh(x, mesh.y)


def one_quad(*corners: tuple[float, float]) -> Mesh:
    """The mesh of a single cell, given counter-clockwise from (0, 0)."""
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = corners
    return Mesh(np.array([[x0, x3], [x1, x2]]), np.array([[y0, y3], [y1, y2]]))


def triangle_errors(mesh: em.Mesh, u: em.Field, uniform: em.Mesh | None = None) -> InterpolationErrors:
    """The errors of linear interpolation on the triangles into which a mesh is cut."""
    return measure_errors(mesh, u, uniform=uniform, kind="triangle")
