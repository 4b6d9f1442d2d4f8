"""scikit-fem reads a mesh, says what it holds, and solves on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import poisson
import skfem
from skfem.helpers import dot, grad

from equimesh_coupling.adaptors.skfem import mesh_of

FORMATS = ("msh",)
VERSION = skfem.__version__


def read(path: str) -> Any:
    return skfem.Mesh.load(path)


def facts(mesh: Any) -> dict[str, Any]:
    basis = skfem.Basis(mesh, mesh.elem())
    areas = skfem.Functional(lambda _: 1.0).elemental(basis)
    turned = mesh.mapping().detDF(np.full((2, 1), 0.4))  # of triangles with any sign: scikit-fem sorts their corners
    smallest = (abs(turned) if isinstance(mesh, skfem.MeshTri) else turned).min()
    sides = {side: np.unique(mesh.facets[:, facets]) for side, facets in mesh.boundaries.items()}
    return {"points": mesh.p.T, "area": areas.sum(), "smallest": smallest, "sides": sides}


def solve(mesh: Any) -> Any:
    element = mesh.elem()
    basis = skfem.Basis(mesh, element, intorder=8)
    right = skfem.FacetBasis(mesh, element, facets="right", intorder=8)
    matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    load = skfem.LinearForm(lambda v, at: poisson.load(*at.x) * v).assemble(basis)

    def flux(v: Any, at: Any) -> Any:
        by_x, by_y = poisson.gradient(*at.x)
        return (by_x * at.n[0] + by_y * at.n[1]) * v

    load += skfem.LinearForm(flux).assemble(right)
    fixed = basis.get_dofs([*poisson.FIXED])
    exact = poisson.w(*basis.doflocs)
    return basis, skfem.solve(*skfem.condense(matrix, load, x=exact, D=fixed))


def strangers(parts: Any) -> list[Any]:
    """A constant element, one with two components, and a vector of another length."""
    mesh = mesh_of(parts)
    constant = skfem.Basis(mesh, skfem.ElementQuad0())
    double = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad1()))
    single = skfem.Basis(mesh, skfem.ElementQuad1())
    return [(constant, constant.zeros()), (double, double.zeros()), (single, np.zeros(3))]
