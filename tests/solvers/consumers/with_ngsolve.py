"""NGSolve reads a mesh, says what it holds, and solves on it."""

from __future__ import annotations

from importlib import metadata
from typing import Any

import ngsolve
import numpy as np
import poisson
from netgen.read_gmsh import ReadGmsh
from ngsolve import BND, H1, BilinearForm, CoefficientFunction, GridFunction, LinearForm, cosh, ds, dx, grad, sinh, x, y

from equimesh_coupling.adaptors.ngsolve import mesh_of

FORMATS = ("msh",)
VERSION = metadata.version("ngsolve")


def read(path: str) -> Any:
    return ngsolve.Mesh(ReadGmsh(path))


def facts(mesh: Any) -> dict[str, Any]:
    points = np.array([vertex.point for vertex in mesh.vertices])
    sides: dict[str, set[int]] = {}
    for edge in mesh.Elements(BND):
        sides.setdefault(edge.mat, set()).update(vertex.nr for vertex in edge.vertices)
    areas = np.array(ngsolve.Integrate(CoefficientFunction(1.0), mesh, element_wise=True))
    cells = [[vertex.nr for vertex in cell.vertices] for cell in mesh.Elements()]
    along = points[[cell[1] for cell in cells]] - points[[cell[0] for cell in cells]]
    across = points[[cell[-1] for cell in cells]] - points[[cell[0] for cell in cells]]
    turned = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    return {"points": points, "area": areas.sum(), "smallest": turned.min(), "sides": sides}


def solve(mesh: Any) -> Any:
    place = poisson.STEEP * (x + poisson.SLANT * y - poisson.PLACE)
    exact = sinh(place) / cosh(place)
    slope = poisson.STEEP * (1 - exact**2)
    load = 2 * poisson.STEEP**2 * (1 + poisson.SLANT**2) * exact * (1 - exact**2)
    space = H1(mesh, order=1, dirichlet="|".join(poisson.FIXED))
    u, v = space.TnT()
    matrix = BilinearForm(grad(u) * grad(v) * dx).Assemble()
    normal = ngsolve.specialcf.normal(2)
    flux = slope * (normal[0] + poisson.SLANT * normal[1])
    form = LinearForm(space)
    form += load * v * dx(bonus_intorder=7)
    form += flux * v * ds("right", bonus_intorder=7)
    form.Assemble()
    solution = GridFunction(space)
    for vertex in mesh.vertices:
        solution.vec[vertex.nr] = float(poisson.w(*vertex.point))
    residual = form.vec - matrix.mat * solution.vec
    solution.vec.data += matrix.mat.Inverse(space.FreeDofs(), "sparsecholesky") * residual
    return solution


def quadratic(mesh: Any) -> Any:
    """The field x^2 + 2 y of order 2."""
    field = GridFunction(H1(mesh, order=2))
    field.Set(x * x + 2.0 * y)
    return field


def strangers(parts: Any) -> list[Any]:
    """A discontinuous field, one with two components, and one of another mesh."""
    mesh = mesh_of(parts)
    other = ngsolve.Mesh(ngsolve.unit_square.GenerateMesh(maxh=0.5))
    return [GridFunction(ngsolve.L2(mesh)), GridFunction(H1(mesh, dim=2)), GridFunction(H1(other))]
