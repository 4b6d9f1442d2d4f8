"""The conformance kit of the transmission conditions in :mod:`equimesh.schwarz.conditions`."""

import math
from dataclasses import replace

import numpy as np

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.expression import Expression
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.numerics.types import Array
from equimesh.schwarz.conditions import Optimized, TransmissionCondition
from equimesh.schwarz.decomposition import Ordering
from equimesh.schwarz.holding.in_one_process import InOneProcess
from equimesh.schwarz.iteration import schwarz_iterations, subdomains_of
from equimesh.schwarz.settings import LocalSolver, Schwarz
from equimesh.single_domain.steps import Mode
from equimesh.solving.solve import solve
from equimesh.testing.functions import require
from equimesh.testing.taylor import wrong_by

PROBLEM = Problem(monitor=ArcLength(u=Expression("tanh(2*(x + y/2 - 0.75))")), grid=Grid(n_xi=16, n_eta=15))
# Subdomains along xi and eta, their overlap, and the ordering.
CASES = (
    ((2, 1), 4, Ordering.PARALLEL),
    ((1, 2), 3, Ordering.ALTERNATING),
    ((3, 1), 5, Ordering.SYMMETRIC),
    ((2, 2), 4, Ordering.PARALLEL),
    ((2, 2), 3, Ordering.COLOURED),
)
LIMIT = 1e-9  # distance of the limit to the single-domain mesh
FIXED = 1e-9  # residual of a subdomain's equations at the single-domain mesh
MAX_ITERATIONS = 200
AWAY = 0.02  # largest move of the nodes away from the solution, where the iteration starts
MOVE = 0.01  # of the nodes, away from the solution, where derivatives are checked


def check_transmission(condition: TransmissionCondition) -> None:
    """Raise :class:`AssertionError` where a transmission condition breaks a promise of its port.

    On a small problem, for strips and blocks with several overlaps: subdomains that receive the data of the
    single-domain mesh keep it; the derivatives of the functionals, as rows of the subdomains' equations, are exact by
    Taylor remainders; and for every ordering the iteration converges to the single-domain mesh within 1e-9, without
    another condition that takes over.
    """
    require(
        isinstance(getattr(condition, "name", None), str) and isinstance(getattr(condition, "ghosts", None), int),
        "name must be a string, and ghosts the number of grid lines that are read beyond an interface",
    )
    _check_strength(condition)
    exact = solve(PROBLEM, mode=Mode.TIGHT).reference
    for counts, overlap, ordering in CASES:
        try:
            settings = Schwarz(
                subdomains=counts,
                overlap=overlap,
                transmission=condition,
                ordering=ordering,
                fallback=False,
                tolerance=LIMIT / 10.0,
            )
        except InputError as error:
            raise AssertionError(f"Schwarz does not take the condition: {error}") from error
        _check_equations(settings, exact)
        _check_limit(settings, exact)


def _check_strength(condition: TransmissionCondition) -> None:
    if isinstance(condition, Optimized):
        return
    for distance in (0.1, 0.5):
        p = condition.strength(distance)
        require(math.isfinite(p) and p >= 0.0, f"strength({distance}) = {p}: it must be finite and not negative")


def _check_equations(settings: Schwarz, exact: Mesh) -> None:
    """The single-domain mesh solves the equations of every subdomain, and their Jacobian is right nearby."""
    case = _describe(settings)
    decomposition, exactly = settings.decompose(PROBLEM.grid), replace(settings, local_solver=LocalSolver.NEWTON)
    subdomains = subdomains_of(PROBLEM, InOneProcess(decomposition), exactly, enough=0.0, threads=1)
    subdomains.restart(exact)
    subdomains.begin(exact)
    random = np.random.default_rng(11)
    for k, window in enumerate(subdomains.windows):
        equations = subdomains.equations(k)
        z = equations.vector(window.restrict(exact))
        residual = np.abs(equations.residual(z))
        require(
            bool(residual.max() <= FIXED),
            f"{case}, subdomain {k} does not keep the single-domain mesh: with its data the equation of"
            f" {_unknown(int(residual.argmax()), window.shape)} has the residual {residual.max():.3g}",
        )
        moves = random.uniform(-1.0, 1.0, (2, z.size)) * ((z > 0.0) & (z < 1.0))  # nodes on a side stay on it
        z, along = z + MOVE * moves[0], moves[1]

        def moved(h: float, equations: MeshEquations = equations, z: Array = z, along: Array = along) -> Array:
            return equations.residual(z + h * along)

        wrong = wrong_by(moved, equations.jacobian(z) @ along)
        worst = int(wrong.argmax())
        require(
            wrong[worst] == 0.0,
            f"{case}, the derivative of the equation of {_unknown(worst, window.shape)} in subdomain {k} is wrong by"
            f" {wrong[worst]:.3g}: the Taylor remainder does not fall at second order",
        )


def _check_limit(settings: Schwarz, exact: Mesh) -> None:
    case, bump = _describe(settings), AWAY * np.sin(np.pi * exact.x) * np.sin(np.pi * exact.y)
    for record in schwarz_iterations(PROBLEM, settings, Mesh(exact.x + bump, exact.y - bump)):
        helped = [subdomain.subdomain for subdomain in record.subdomains if subdomain.classical]
        require(not helped, f"{case}, classical data took the place of the condition in subdomain {helped[:1]}")
        require(
            record.iteration < MAX_ITERATIONS and not record.failed,
            f"{case}, the iteration does not converge: after {record.iteration} iterations the mesh still moves by"
            f" {record.change:.3g}",
        )
        if record.meets(LIMIT / 10.0):
            break
    apart = max(np.abs(record.reference.x - exact.x).max(), np.abs(record.reference.y - exact.y).max())
    require(apart <= LIMIT, f"{case}, the limit differs from the single-domain mesh by {apart:.3g}")


def _describe(settings: Schwarz) -> str:
    columns, rows = settings.counts
    return f"with {columns} x {rows} subdomains, an overlap of {settings.overlap} and {settings.ordering} ordering"


def _unknown(row: int, shape: tuple[int, int]) -> str:
    """The unknown that a row of a subdomain's equations belongs to, in words."""
    node = np.unravel_index(row % (shape[0] * shape[1]), shape)
    return f"{'xy'[row // (shape[0] * shape[1])]} at node ({node[0]}, {node[1]})"
