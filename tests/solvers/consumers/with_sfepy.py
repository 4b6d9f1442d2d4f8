"""SfePy reads a mesh, says what it holds, and solves on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import poisson
import sfepy
from sfepy.base.base import output
from sfepy.discrete import Equation, Equations, FieldVariable, Function, Integral, Material, Problem
from sfepy.discrete.conditions import Conditions, EssentialBC
from sfepy.discrete.fem import FEDomain, Field, Mesh
from sfepy.solvers.ls import ScipyDirect
from sfepy.solvers.nls import Newton
from sfepy.terms import Term

from equimesh_coupling.adaptors.sfepy import mesh_of

FORMATS = ("vtk",)
VERSION = sfepy.__version__
# The groups of a side in a vtk file, with those of its two corners.
GROUPS = {"left": (1, 13, 14), "right": (2, 23, 24), "bottom": (3, 13, 23), "top": (4, 14, 24)}
output.set_output(quiet=True)


def read(path: str) -> Any:
    return Mesh.from_file(path)


def _domain(mesh: Any) -> tuple[Any, Any, dict[str, Any]]:
    domain = FEDomain("domain", mesh)
    inside = domain.create_region("Omega", "all")
    chosen = {side: " +v ".join(f"vertices of group {group}" for group in groups) for side, groups in GROUPS.items()}
    if mesh.nodal_bcs:
        chosen = {side: f"vertices of set {side}" for side in GROUPS}
    return domain, inside, {side: domain.create_region(side, where, "facet") for side, where in chosen.items()}


def facts(mesh: Any) -> dict[str, Any]:
    _, _, regions = _domain(mesh)
    areas = mesh.cmesh.get_volumes(2)
    corners = mesh.coors[mesh.get_conn(mesh.descs[0])]
    along, across = corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0]
    turned = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    sides = {side: region.vertices for side, region in regions.items()}
    return {"points": mesh.coors, "area": areas.sum(), "smallest": turned.min(), "sides": sides}


def solve(mesh: Any) -> Any:
    _, inside, regions = _domain(mesh)
    field = Field.from_args("w", np.float64, "scalar", inside, approx_order=1)
    u, v = FieldVariable("u", "unknown", field), FieldVariable("v", "test", field, primary_var_name="u")

    def at_points(_time: Any, coors: Any, mode: Any = None, **_: Any) -> Any:
        if mode != "qp":
            return None
        x, y = coors.T
        return {"load": poisson.load(x, y).reshape(-1, 1, 1), "slope": np.stack(poisson.gradient(x, y), 1)[:, :, None]}

    data = Material("data", function=Function("data", at_points))
    rule = Integral("i", order=8)
    terms = (
        Term.new("dw_laplace(v, u)", rule, inside, v=v, u=u)
        - Term.new("dw_volume_lvf(data.load, v)", rule, inside, data=data, v=v)
        - Term.new("dw_surface_ndot(data.slope, v)", rule, regions["right"], data=data, v=v)
    )
    exact = Function("exact", lambda _time, coors, **_: poisson.w(*coors.T))
    fixed = Conditions([EssentialBC(side, regions[side], {"u.0": exact}) for side in poisson.FIXED])
    problem = Problem("poisson", equations=Equations([Equation("balance", terms)]))
    problem.set_bcs(ebcs=fixed)
    problem.set_solver(Newton({}, lin_solver=ScipyDirect({})))
    problem.solve(save_results=False)
    return u


def strangers(parts: Any) -> list[Any]:
    """A field with two components, a constant one, and a scalar one of another mesh."""
    mesh = mesh_of(parts)
    half = Mesh.from_data("half", mesh.coors[:4], None, [np.array([[0, 1, 3, 2]], dtype=np.int32)], [[1]], ["2_4"])
    found = []
    for of, components in ((mesh, "vector"), (half, "scalar")):
        inside = FEDomain("domain", of).create_region("Omega", "all")
        field = Field.from_args("w", np.float64, components, inside, approx_order=1)
        variable = FieldVariable("u", "unknown", field)
        variable.set_constant(0.0)
        found.append(variable)
    return found
