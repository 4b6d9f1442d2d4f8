"""MFEM reads a mesh, says what it holds, and solves on it."""

from __future__ import annotations

from importlib import metadata
from typing import Any

import numpy as np
import poisson
from mfem import ser as mfem

from equimesh_coupling.adaptors.mfem import mesh_of

FORMATS = ("msh",)
VERSION = metadata.version("mfem")
SIDES = {1: "left", 2: "right", 3: "bottom", 4: "top"}


class Exact(mfem.PyCoefficient):
    def EvalValue(self, x: Any) -> float:
        return float(poisson.w(x[0], x[1]))


class Load(mfem.PyCoefficient):
    def EvalValue(self, x: Any) -> float:
        return float(poisson.load(x[0], x[1]))


class Slope(mfem.VectorPyCoefficient):
    def EvalValue(self, x: Any) -> list[float]:
        return [float(value) for value in poisson.gradient(x[0], x[1])]


def read(path: str) -> Any:
    return mfem.Mesh(path, 1, 1)


def facts(mesh: Any) -> dict[str, Any]:
    sides: dict[str, set[int]] = {side: set() for side in SIDES.values()}
    for k in range(mesh.GetNBE()):
        sides[SIDES[mesh.GetBdrAttribute(k)]] |= set(mesh.GetBdrElementVertices(k))
    areas = [mesh.GetElementVolume(k) for k in range(mesh.GetNE())]
    smallest = -1.0 if mesh.CheckElementOrientation(False) else min(areas)
    points = np.array(mesh.GetVertexArray())[:, :2]
    return {"points": points, "area": sum(areas), "smallest": smallest, "sides": sides}


def solve(mesh: Any) -> Any:
    collection = mfem.H1_FECollection(1, 2)
    space = mfem.FiniteElementSpace(mesh, collection)
    rule = mfem.IntRules.Get(mesh.GetElementBaseGeometry(0), 6)
    edge_rule = mfem.IntRules.Get(mfem.Geometry.SEGMENT, 6)
    load, exact, slope, one = Load(), Exact(), Slope(2), mfem.ConstantCoefficient(1.0)

    right = mfem.intArray([0, 1, 0, 0])
    form = mfem.LinearForm(space)
    inner = mfem.DomainLFIntegrator(load)
    inner.SetIntRule(rule)
    form.AddDomainIntegrator(inner)
    outer = mfem.BoundaryNormalLFIntegrator(slope)
    outer.SetIntRule(edge_rule)
    form.AddBoundaryIntegrator(outer, right)
    form.Assemble()

    matrix_form = mfem.BilinearForm(space)
    matrix_form.AddDomainIntegrator(mfem.DiffusionIntegrator(one))
    matrix_form.Assemble()

    fixed = mfem.intArray()
    space.GetEssentialTrueDofs(mfem.intArray([1, 0, 1, 1]), fixed)
    u = mfem.GridFunction(space)
    u.ProjectCoefficient(exact)
    matrix, x, b = mfem.OperatorPtr(), mfem.Vector(), mfem.Vector()
    matrix_form.FormLinearSystem(fixed, u, form, matrix, x, b)
    sparse = mfem.OperatorHandle2SparseMatrix(matrix)
    mfem.PCG(sparse, mfem.GSSmoother(sparse), b, x, 0, 2000, 1e-24, 0.0)
    matrix_form.RecoverFEMSolution(x, form, u)
    u.kept = (space, collection)  # MFEM frees what Python forgets
    return u


class Quadratic(mfem.PyCoefficient):  # type: ignore[misc]
    def EvalValue(self, x: Any) -> float:
        return float(x[0] ** 2 + 2.0 * x[1])


def quadratic(mesh: Any) -> Any:
    """The field x^2 + 2 y of order 2, which keeps its space."""
    collection = mfem.H1_FECollection(2, 2)
    space = mfem.FiniteElementSpace(mesh, collection)
    field = mfem.GridFunction(space)
    field.ProjectCoefficient(Quadratic())
    field.kept = mesh, collection, space
    return field


def strangers(parts: Any) -> list[Any]:
    """A discontinuous field, one with two components, and one of another mesh."""
    mesh, other = mesh_of(parts), mfem.Mesh(2, 2, "QUADRILATERAL", False, 1.0, 1.0, True)
    found = []
    for of, collection, components in (
        (mesh, mfem.L2_FECollection(1, 2), 1),
        (mesh, mfem.H1_FECollection(1, 2), 2),
        (other, mfem.H1_FECollection(1, 2), 1),
    ):
        space = mfem.FiniteElementSpace(of, collection, components)
        field = mfem.GridFunction(space)
        field.kept = (of, space, collection)
        found.append(field)
    return found
