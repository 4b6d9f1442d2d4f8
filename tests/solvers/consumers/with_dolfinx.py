"""FEniCSx dolfinx reads a mesh, says what it holds, and solves on it."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import poisson
import ufl
from dolfinx import fem
from dolfinx.cpp.mesh import entities_to_geometry
from dolfinx.fem.petsc import LinearProblem
from dolfinx.io import XDMFFile
from dolfinx.mesh import create_unit_square
from mpi4py import MPI

from equimesh_coupling.adaptors.dolfinx import mesh_of

try:
    import gmsh
    from dolfinx.io import gmshio
except ImportError:
    gmsh = None

FORMATS = ("xdmf", "msh") if gmsh else ("xdmf",)
COMM = MPI.COMM_WORLD
VERSION = dolfinx.__version__
SIDES = {1: "left", 2: "right", 3: "bottom", 4: "top"}


def read(path: str) -> tuple[Any, Any]:
    """The mesh, and the tags of its facets."""
    if path.endswith(".msh"):
        return _read_msh(path)
    with XDMFFile(MPI.COMM_WORLD, path, "r") as file:
        mesh = file.read_mesh(name="Grid")
    mesh.topology.create_connectivity(1, 2)
    with XDMFFile(MPI.COMM_WORLD, path.replace(".xdmf", "_facets.xdmf"), "r") as file:
        return mesh, file.read_meshtags(mesh, name="Grid")


def _read_msh(path: str) -> tuple[Any, Any]:
    """The same through Gmsh: `read_from_msh` of version 0.5 fails."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(path)
    mesh, _, tags = gmshio.model_to_mesh(gmsh.model, MPI.COMM_WORLD, 0, gdim=2)
    gmsh.finalize()
    return mesh, tags


def facts(both: tuple[Any, Any]) -> dict[str, Any]:
    mesh, tags = both
    numbers = np.asarray(mesh.geometry.input_global_indices)
    points = np.empty((len(numbers), 2))
    points[numbers] = mesh.geometry.x[:, :2]
    area = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * ufl.dx(domain=mesh)))
    smallest = fem.petsc.assemble_vector(fem.form(_signs(mesh))).array.min()
    mesh.topology.create_connectivity(1, 0)
    sides = {}
    for tag, side in SIDES.items():
        facets = tags.indices[tags.values == tag]
        sides[side] = np.unique(numbers[_nodes_of(mesh, facets)])
    return {"points": points, "area": area, "smallest": smallest, "sides": sides}


def _signs(mesh: Any) -> Any:
    """The Jacobian of every cell, integrated over it: negative where the cell is turned."""
    test = ufl.TestFunction(fem.FunctionSpace(mesh, ("DG", 0)))
    return ufl.JacobianDeterminant(mesh) * test * ufl.dx


def exact(mesh: Any) -> Any:
    """The exact solution as a formula of UFL."""
    x, y = ufl.SpatialCoordinate(mesh)
    return ufl.tanh(poisson.STEEP * (x + poisson.SLANT * y - poisson.PLACE))


def solve(both: tuple[Any, Any]) -> Any:
    mesh, tags = both
    space = fem.FunctionSpace(mesh, ("Lagrange", 1))
    w = exact(mesh)
    load = 2 * poisson.STEEP**2 * (1 + poisson.SLANT**2) * w * (1 - w**2)
    normal = ufl.FacetNormal(mesh)
    flux = poisson.STEEP * (1 - w**2) * (normal[0] + poisson.SLANT * normal[1])
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    precise = {"quadrature_degree": 8}
    right = ufl.ds(2, domain=mesh, subdomain_data=tags, metadata=precise)
    fixed = fem.Function(space)
    fixed.interpolate(lambda at: poisson.w(at[0], at[1]))
    facets = tags.indices[np.isin(tags.values, (1, 3, 4))]
    dofs = fem.locate_dofs_topological(space, 1, facets)
    problem = LinearProblem(
        ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx,
        load * v * ufl.dx(metadata=precise) + flux * v * right,
        bcs=[fem.dirichletbc(fixed, dofs)],
        petsc_options={"ksp_type": "preonly", "pc_type": "lu"},
    )
    return problem.solve()


def _nodes_of(mesh: Any, facets: Any) -> Any:
    """The nodes of facets; the function takes the C++ object of the mesh."""
    inner = getattr(mesh, "_cpp_object", None) or mesh._mesh
    return entities_to_geometry(inner, 1, facets, False)


def linear(both: tuple[Any, Any]) -> Any:
    """The field x + 2 y."""
    field = fem.Function(fem.FunctionSpace(both[0], ("Lagrange", 1)))
    field.interpolate(lambda at: at[0] + 2.0 * at[1])
    return field


def quadratic(both: tuple[Any, Any]) -> Any:
    """The field x^2 + 2 y of order 2."""
    field = fem.Function(fem.FunctionSpace(both[0], ("Lagrange", 2)))
    field.interpolate(lambda at: at[0] ** 2 + 2.0 * at[1])
    return field


def strangers(parts: Any) -> list[Any]:
    """A field of another order, one with two components, and one of another mesh."""
    mesh, _ = mesh_of(parts, MPI.COMM_WORLD)
    other = create_unit_square(MPI.COMM_WORLD, 2, 2)
    spaces = (
        fem.FunctionSpace(mesh, ("Lagrange", 2)),
        fem.VectorFunctionSpace(mesh, ("Lagrange", 1)),
        fem.FunctionSpace(other, ("Lagrange", 1)),
    )
    return [fem.Function(space) for space in spaces]
