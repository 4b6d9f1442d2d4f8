"""Every monitor on every kind of domain: the same equations, pulled back, solved by the same solver."""

from __future__ import annotations

from itertools import cycle, pairwise

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.equations.mesh_equations import MeshEquations
from equimesh.single_domain import iteration
from equimesh.sweeps.deviation import deviation

BELL = em.Expression("exp(-8*((x - 0.4)**2 + (y - 0.6)**2))")
DOMAINS: dict[str, em.Domain] = {
    "square": em.Rectangle(),
    "rectangle": em.Rectangle(x=(-0.5, 1.5), y=(0.0, 1.2)),
    "annulus": em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0)),
    "quadrilateral": em.Quadrilateral(
        bottom=em.Curve.of_expressions("1.2*t", "0.1*sin(pi*t)"),
        right=em.Curve.of_expressions("1.2 + 0.1*t*(1 - t)", "1.1*t"),
        top=em.Curve.through([[0.0, 0.9], [0.3, 1.0], [0.7, 1.1], [1.2, 1.1]]),
        left=em.Curve.through([[0.0, 0.0], [0.0, 0.9]]),
    ),
}
MONITORS: dict[str, em.Monitor] = {
    "arc_length": em.ArcLength(u=BELL),
    "curvature_l2": em.Curvature(u=BELL),
    "curvature_h1": em.Curvature(u=BELL, norm="h1"),
    "isotropic": em.Curvature(u=BELL, isotropic=True),
    "weight": em.Weight(rho=em.Expression("1 + 4*exp(-10*((x - 0.4)**2 + (y - 0.6)**2))")),
    "tensor": em.Tensor(m11=em.Expression("2 + sin(3*x)"), m12=em.Expression("0.3*y"), m22=em.Expression("1 + x**2")),
    "intersection": em.Intersection(monitors=(em.ArcLength(u=BELL), em.Weight(rho=em.Expression("1 + x**2 + y**2")))),
    "smoothed": em.Smoothed(monitor=em.ArcLength(u=BELL), radius=0.08),
}
PAIRS = [("arc_length", domain) for domain in DOMAINS]
PAIRS += [(monitor, domain) for monitor in list(MONITORS)[1:] for domain in ("square", "annulus")]


def case(monitor: str, domain: str, n: int, m: int | None = None, **more: em.Boundary) -> em.Problem:
    grid = em.Grid(n_xi=n, n_eta=m or n)
    return em.Problem(monitor=MONITORS[monitor], grid=grid, domain=DOMAINS[domain], **more)


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return max(abs(one.x - other.x).max(), abs(one.y - other.y).max())


@pytest.mark.parametrize(("monitor", "domain"), PAIRS)
def test_the_mesh_is_that_of_newton(monitor: str, domain: str) -> None:
    problem = case(monitor, domain, 21, 18)
    *_, fast = iteration.single_domain_steps(problem)
    *_, reference = iteration.single_domain_steps(problem, sweeps=False)
    assert fast.relaxation.is_none
    assert reference.relaxation.is_none
    assert distance(fast.mesh, reference.mesh) < 1e-9
    assert deviation(problem.metric, problem.boundary, reference.mesh) < 1e-9
    assert distance(fast.mesh, em.Mesh.uniform(problem.grid)) > 0.01, "nothing was adapted to"


@pytest.mark.parametrize(
    ("monitor", "domain", "boundary"), [(*pair, b) for pair, b in zip(PAIRS, cycle(em.Boundary), strict=False)]
)
def test_the_jacobian_is_exact(monitor: str, domain: str, boundary: em.Boundary) -> None:
    problem = case(monitor, domain, 8, 7, boundary=boundary)
    equations, random = problem.equations(), np.random.default_rng(7)
    z = equations.vector(em.Mesh.uniform(problem.grid))
    inside = np.zeros((2, 8, 7))
    inside[:, 1:-1, 1:-1] = 1.0
    v = random.standard_normal(z.size) * inside.ravel()
    v[[8 * 7 + 3, 3 * 7]] = 1.0  # y of a node on the left, x of one at the bottom: they move along their sides
    z = z + 0.01 * random.standard_normal(z.size) * inside.ravel()
    remainders = [remainder(equations, z, h * v) for h in (2e-3, 1e-3, 5e-4)]
    for coarse, fine in pairwise(remainders):
        assert 3.7 < coarse / fine < 4.3


def remainder(equations: MeshEquations, z: np.ndarray, v: np.ndarray) -> float:
    return float(np.linalg.norm(equations.residual(z + v) - equations.residual(z) - equations.jacobian(z) @ v))


# The eigenvalues of the Hessian of a convex function change no sign: where they do, |H| has a kink, and the order is
# less. The two boundary conditions of the paper need zero normal derivatives on the sides.
NARROW = em.Expression("exp(-25*((x - 0.5)**2 + (y - 0.48)**2))")
CONVEX = em.Expression("exp(2*x) + exp(3*y) + x*y")
SMOOTH: list[tuple[em.Monitor, str, em.Boundary]] = [
    (monitor, domain, boundary)
    for domain in DOMAINS
    for monitor, boundary in (
        (MONITORS["arc_length"], em.Boundary.TRACE),
        (em.ArcLength(u=NARROW, a=0.3, scaled=False), em.Boundary.EQUIDISTRIBUTED_1D),
        (em.ArcLength(u=NARROW, a=0.3, scaled=False), em.Boundary.ORTHOGONAL),
    )
    if not (domain == "quadrilateral" and boundary is em.Boundary.ORTHOGONAL)  # its corners are no right angles
]
SMOOTH += [
    (monitor, domain, em.Boundary.TRACE)
    for monitor in (em.Curvature(u=CONVEX), em.Curvature(u=CONVEX, isotropic=True), MONITORS["weight"])
    for domain in ("square", "annulus")
]


# Without --everything each monitor, boundary, and domain but the square, which is in tests/proofs/test_order.py.
ORDINARY = range(4, len(SMOOTH), 2)


@pytest.mark.parametrize(
    ("monitor", "domain", "boundary"),
    [pytest.param(*one, marks=() if k in ORDINARY else pytest.mark.everything) for k, one in enumerate(SMOOTH)],
    ids=lambda v: getattr(v, "value", None),
)
def test_second_order(monitor: em.Monitor, domain: str, boundary: em.Boundary) -> None:
    sizes, meshes = (33, 65, 129, 257), {}
    for n in sizes:
        grid = em.Grid(n_xi=n, n_eta=n)
        *_, last = iteration.single_domain_steps(
            em.Problem(monitor=monitor, grid=grid, domain=DOMAINS[domain], boundary=boundary)
        )
        assert last.relaxation.is_none
        meshes[n] = last.mesh
    errors = []
    for n in sizes[:-1]:
        every = slice(None, None, 256 // (n - 1))
        errors.append(distance(meshes[n], em.Mesh(meshes[257].x[every, every], meshes[257].y[every, every])))
    seen = [1 / (n - 1) ** 2 - 1 / 256**2 for n in sizes[:-1]]
    orders = 2 * np.diff(np.log(errors)) / np.diff(np.log(seen))
    assert all(1.6 < order < 2.3 for order in orders), (orders, errors)
    assert 1.88 < orders[-1] < 2.1, (orders, errors)
    assert errors[-1] < 2e-4


@pytest.mark.parametrize("domain", ["square", "rectangle", "annulus"])
def test_without_adaptation_lines_have_equal_lengths(domain: str) -> None:
    """For a = 0 the metric is that of the plane: on these domains the uniform mesh is the solution."""
    problem = em.Problem(monitor=em.ArcLength(u=BELL, a=0.0), grid=em.Grid(n_xi=13, n_eta=9), domain=DOMAINS[domain])
    solution = em.solve(problem, mode=em.Mode.TIGHT)
    # Edges of an annulus are chords, measured with the metric at the middle of their cells.
    assert distance(solution.mesh, map_mesh(em.Mesh.uniform(problem.grid), problem.domain)) < 1e-12


@pytest.mark.parametrize("condition", [em.Classical(), em.LinearRobin(), em.NonlinearRobin()], ids=lambda c: c.name)
@pytest.mark.parametrize(("monitor", "domain"), [("arc_length", "annulus"), ("weight", "square")])
def test_the_schwarz_limit_is_the_single_domain_mesh(
    monitor: str, domain: str, condition: em.TransmissionCondition
) -> None:
    problem = case(monitor, domain, 15, 13)
    settings = em.Schwarz(transmission=condition, tolerance=1e-11, compare_single_domain=True)
    solution = em.solve(problem, settings)
    assert solution.status is em.Status.CONVERGED
    error = solution.iterations[-1].error
    assert error < 1e-9
    assert distance(solution.mesh, em.solve(problem, mode=em.Mode.TIGHT).mesh) < 1e-9


class Swirl(em.Rectangle):
    """The unit square stirred in its middle; the map keeps areas, so that it does not fold."""

    is_unit_square = False

    def map(self, s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = s - 0.5, t - 0.5
        turn = 3.0 * np.exp(-10.0 * (x**2 + y**2))
        return 0.5 + x * np.cos(turn) - y * np.sin(turn), 0.5 + x * np.sin(turn) + y * np.cos(turn)


def test_a_domain_too_curved_for_its_grid_is_refused() -> None:
    fine, coarse = em.Grid(n_xi=65, n_eta=65), em.Grid(n_xi=9, n_eta=9)
    assert not map_mesh(em.Mesh.uniform(fine), Swirl()).is_folded
    with pytest.raises(em.InputError, match="add grid points"):
        em.solve(em.Problem(monitor=MONITORS["arc_length"], grid=coarse, domain=Swirl()))


def test_sweeps_that_leave_the_domain_are_stopped() -> None:
    """They do here, and a table that is asked for what is not a number answers with that, and nothing else."""
    front = em.Expression("tanh(30*(hypot(x, y) - 1.5 - 0.1*sin(3*atan2(y, x))))")
    monitor = em.Smoothed(monitor=em.Curvature(u=front), radius=0.02)
    domain = em.AnnulusSector(angles=(0.0, 120.0))
    solution = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=33, n_eta=65), domain=domain))
    assert not solution.mesh.is_folded
    assert solution.certificate.interpolation.gain_l2 > 5
    values = monitor.on(domain).metric(np.array([np.nan, 1.5]), np.array([0.2, 0.2]))
    assert all(np.isnan(entry[0]) and np.isfinite(entry[1]) for entry in values)
