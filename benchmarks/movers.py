"""Meshes whose nodes are moved and whose cells stay: TMOP of MFEM, GFMMPDE of FEALPy, and our own.

All of them start from the uniform mesh of quadrilaterals. TMOP takes its targets from the curvature of u, at the places
where the nodes begin: areas, and for two of its metrics also ratios and directions of the edges. FEALPy has its own
monitor of the arc length, with the settings of its own model.
"""

from __future__ import annotations

import contextlib
import importlib
import io
from types import SimpleNamespace
from typing import Any

import numpy as np
from made_meshes import BOTTOM, LEFT, RIGHT, TOP, Array, Made, Timer, sides_of_grid

import equimesh as em

TMOP_SIDES = {1: BOTTOM, 2: RIGHT, 3: TOP, 4: LEFT}
"""The attributes of MFEM's Cartesian mesh."""
TMOP_METRICS = {"size": 80, "shape, size, direction": 14, "shape, direction": 85}
"""TMOP's numbers of its metrics, by what they compare with the target."""
TMOP_STEPS = 40
"""Newton steps of TMOP, at most."""
TMOP_TOLERANCE = 1e-6
"""Of the gradient of its functional, relative to the first one."""
FEALPY = {"tau": 0.5, "t_max": 0.5, "mol_times": 5, "alpha": 0.5}
"""The settings with which FEALPy's model of Allen and Cahn moves its mesh."""
FEALPY_BETA = 0.5
"""The weight of the gradient in its monitor, the default of that model."""
OWN = (
    "`auto` for `interpolation`",
    "`least_error`",
    "`least_error`, norm `h1`",
    "`arc_length`",
    "`weight`, gradient map",
)
"""Our monitors in the table."""
DENSITY_POINTS = 257
"""Points a side of the density for our gradient map."""


def own_monitors(u: em.Expression) -> dict[str, em.Monitor]:
    """Our monitors by their names in the table. The gradient map has the density of the isotropic curvature."""
    axis = np.linspace(0.0, 1.0, DENSITY_POINTS)
    curvature = em.Curvature(u=u, isotropic=True).on(em.Rectangle())
    density = curvature.metric(*np.meshgrid(axis, axis, indexing="ij"))[0]
    rho = em.GridSamples(x=axis, y=axis, values=density)
    monitors = (
        em.Auto(u=u, purpose="interpolation"),
        em.LeastError(u=u),
        em.LeastError(u=u, norm="h1"),
        em.ArcLength(u=u),
        em.Weight(rho=rho, u=u, map="gradient"),
    )
    return dict(zip(OWN, monitors, strict=True))


def own(kind: str, u: em.Expression, n: int) -> Made:
    """Our mesh for this monitor, by the second of two solves: the first one loads the kernels."""
    problem = em.Problem(monitor=own_monitors(u)[kind], grid=em.Grid(n_xi=n, n_eta=n))
    for _ in range(2):
        timer = Timer()
        with timer.on():
            solution = em.solve(problem, threads=1, check=False)
    mesh, (edges, tags) = solution.mesh, sides_of_grid(n)
    cells = mesh.cells.astype(np.int64)
    note = "relaxed" if solution.status == "relaxed" else ""
    return Made(points=mesh.points, cells=cells, edges=edges, tags=tags, seconds=timer.seconds, note=note)


def tmop(kind: str, u: em.Expression, n: int) -> Made:
    """TMOP: Newton's method with MINRES, on the metric of this kind; nodes of the sides slide."""
    mfem = importlib.import_module("mfem.ser")
    mesh = mfem.Mesh.MakeCartesian2D(n - 1, n - 1, mfem.Element.QUADRILATERAL, True, 1.0, 1.0)
    mesh.SetCurvature(1)
    nodes = mesh.GetNodes()
    space = nodes.FESpace()

    def points() -> Array:
        values = np.array(nodes.GetDataArray())
        return values.reshape(2, -1).T if space.GetOrdering() == 0 else values.reshape(-1, 2)

    timer = Timer()
    with timer.on():
        solver, _kept = _tmop_solver(mfem, mesh, kind, u, points())
        nodes.SetTrueVector()
        solver.Mult(mfem.Vector(), nodes.GetTrueVector())
        nodes.SetFromTrueVector()
    cells = np.array([list(mesh.GetElementVertices(i)) for i in range(mesh.GetNE())], dtype=np.int64)
    sides = range(mesh.GetNBE())
    edges = np.array([list(mesh.GetBdrElementVertices(i)) for i in sides], dtype=np.int64)
    tags = np.array([TMOP_SIDES[mesh.GetBdrAttribute(i)] for i in sides])
    note = "" if solver.GetConverged() else f"not converged in {solver.GetNumIterations()} steps"
    return Made(points=points(), cells=cells, edges=edges, tags=tags, seconds=timer.seconds, note=note)


def _tmop_solver(mfem: Any, mesh: Any, kind: str, u: em.Expression, points: Array) -> tuple[Any, list[Any]]:
    """TMOP's solver, and the objects that have to live as long."""
    library, tools = (importlib.import_module(f"mfem._ser.{name}") for name in ("tmop", "tmop_tools"))
    number = TMOP_METRICS[kind]
    metric = getattr(library, f"TMOP_Metric_{number:03d}")(*((0.5,) if number == 80 else ()))
    targets, kept = _tmop_targets(mfem, mesh, kind, u, points)
    targets.SetNodes(mesh.GetNodes())
    rules = mfem.IntegrationRules(0, mfem.Quadrature1D.GaussLobatto)
    rule = rules.Get(mfem.Geometry.SQUARE, 8)
    integrator = library.TMOP_Integrator(metric, targets)
    integrator.SetIntegrationRule(rule)
    space = mesh.GetNodes().FESpace()
    form = mfem.NonlinearForm(space)
    form.AddDomainIntegrator(integrator)
    integrator.thisown = 0
    form.SetEssentialVDofs(mfem.intArray(_held(mfem, mesh, space)))
    linear = mfem.MINRESSolver()
    linear.SetMaxIter(100)
    linear.SetRelTol(1e-8)
    linear.SetAbsTol(0.0)
    solver = tools.TMOPNewtonSolver(rule, 0)
    solver.SetPreconditioner(linear)
    solver.SetMaxIter(TMOP_STEPS)
    solver.SetRelTol(TMOP_TOLERANCE)
    solver.SetAbsTol(0.0)
    solver.SetPrintLevel(-1)
    solver.SetOperator(form)
    return solver, [metric, targets, rules, form, linear, *kept]


def _tmop_targets(mfem: Any, mesh: Any, kind: str, u: em.Expression, points: Array) -> tuple[Any, list[Any]]:
    """The targets as functions at the nodes: areas, and for other kinds than "size" ratios and directions of edges."""
    library, tools = (importlib.import_module(f"mfem._ser.{name}") for name in ("tmop", "tmop_tools"))
    collection = mfem.H1_FECollection(1, 2)
    space = mfem.FiniteElementSpace(mesh, collection)
    kept: list[Any] = [collection, space]

    def function(values: Array) -> Any:
        found = mfem.GridFunction(space)
        found.Assign(mfem.Vector(np.ascontiguousarray(values)))
        kept.append(found)
        return found

    isotropic = kind == "size"
    m11, m12, m22 = em.Curvature(u=u, isotropic=isotropic).on(em.Rectangle()).metric(*points.T)
    squares, directions = np.linalg.eigh(np.moveaxis(np.array([[m11, m12], [m12, m22]]), -1, 0))
    density = np.sqrt(squares.prod(axis=1))
    types = library.TargetConstructor
    targets = library.DiscreteAdaptTC(types.IDEAL_SHAPE_GIVEN_SIZE if isotropic else types.GIVEN_SHAPE_AND_SIZE)
    evaluator = tools.AdvectorCG()
    targets.SetAdaptivityEvaluator(evaluator)
    kept.append(evaluator)
    targets.SetSerialDiscreteTargetSize(function(density.mean() / density / mesh.GetNE()))
    if not isotropic:
        angle, ratio = _edges(directions[:, :, 0], np.sqrt(squares[:, 1] / squares[:, 0]))
        targets.SetSerialDiscreteTargetAspectRatio(function(ratio))
        targets.SetSerialDiscreteTargetOrientation(function(angle))
    return targets, kept


def _edges(long: Array, ratio: Array) -> tuple[Array, Array]:
    """The angle of the xi-edges, and the length of the eta-edges over theirs.

    ``long`` are the directions of the long edges, and ``ratio`` how much longer they are. The xi-edges are the long
    ones or the short ones, whichever are closer to the x-axis.
    """
    angle = (np.arctan2(long[:, 1], long[:, 0]) + np.pi / 2) % np.pi - np.pi / 2
    is_xi_long = np.abs(angle) <= np.pi / 4
    across = np.where(angle > 0.0, angle - np.pi / 2, angle + np.pi / 2)
    return np.where(is_xi_long, angle, across), np.where(is_xi_long, 1.0 / ratio, ratio)


def _held(mfem: Any, mesh: Any, space: Any) -> list[int]:
    """The unknowns that stay: y on the sides below and above, x on the others."""
    held: set[int] = set()
    for i in range(mesh.GetNBE()):
        unknowns = mfem.intArray()
        space.GetBdrElementVDofs(i, unknowns)
        found = unknowns.ToList()
        half = len(found) // 2
        held |= {*(found[half:] if TMOP_SIDES[mesh.GetBdrAttribute(i)] in (BOTTOM, TOP) else found[:half])}
    return sorted(held)


def fealpy(u: em.Expression, n: int) -> Made:
    """FEALPy's GFMMPDE, which reads u anew wherever it has moved the nodes."""
    module = importlib.import_module
    bm = module("fealpy.backend").backend_manager
    mesh = module("fealpy.mesh").QuadrangleMesh.from_box([0, 1, 0, 1], nx=n - 1, ny=n - 1)
    mesh.nodedata["vertices"] = bm.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    space = module("fealpy.functionspace").LagrangeFESpace(mesh, p=1)

    def value(p: Array) -> Array:
        return u.evaluate(p[:, 0], p[:, 1])[0]

    uh = space.function()
    uh[:] = value(mesh.node)
    problem = SimpleNamespace(solution=value, init_solution=value)
    config = module("fealpy.mmesh.config").Config(
        active_method="GFMMPDE", is_pre=False, pde=problem, int_meth="solution", **FEALPY
    )
    timer = Timer()
    with contextlib.redirect_stdout(io.StringIO()), timer.on():
        mesher = module("fealpy.mmesh.mmesher").MMesher(mesh, uh, space, FEALPY_BETA, config=config)
        mesher.initialize()
        mesher.set_monitor("arc_length")
        mesher.set_mol_method("projector")
        mesher.set_interpolation_method("solution")
        mesher.run()
    (edges, tags), cells = sides_of_grid(n), np.asarray(mesh.entity("cell"), dtype=np.int64)
    return Made(points=np.asarray(mesh.node), cells=cells, edges=edges, tags=tags, seconds=timer.seconds)
