"""A bound of the angles of non-orthogonality: it holds for every way to a mesh, and the certificate says the price."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.quality.faces import measure_faces
from equimesh.solving import orthogonality
from equimesh.testing.geometries import l_shape

STEEP = em.Expression("tanh(30*(y - 0.5 - 0.25*sin(2*pi*x)))")
PEAK = em.Expression("1 + 60*exp(-300*(x + y - 1)**2)")
BOUND = 25.0
MONITORS: dict[str, em.Monitor] = {
    "auto": em.Auto(u=STEEP, orthogonality=BOUND),
    "least_error": em.LeastError(u=STEEP, orthogonality=BOUND),
    "h1": em.LeastError(u=STEEP, norm="h1", orthogonality=BOUND),
    "arc_length": em.ArcLength(u=STEEP, orthogonality=BOUND),
    "curvature": em.Curvature(u=STEEP, isotropic=True, orthogonality=BOUND),
    "smoothed": em.Smoothed(monitor=em.ArcLength(u=STEEP, orthogonality=BOUND), radius=0.02),
    "weight": em.Weight(rho=PEAK, orthogonality=BOUND),
    "gradient": em.Weight(rho=PEAK, map="gradient", orthogonality=BOUND),
    "tensor": em.Tensor(m11=PEAK, m12=em.Expression("0.5"), m22=PEAK, orthogonality=BOUND),
    "intersection": em.Intersection(monitors=(em.Weight(rho=PEAK), em.ArcLength(u=STEEP, orthogonality=BOUND))),
    "own": em.Intersection(monitors=(em.Weight(rho=PEAK), em.ArcLength(u=STEEP)), orthogonality=BOUND),
}


def solved(monitor: em.Monitor, schwarz: em.Schwarz | None = None, **more: Any) -> em.Solution:
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=17, n_eta=17), domain=more.pop("domain", em.Rectangle()))
    return em.solve(problem, schwarz, **more)


@pytest.mark.parametrize("name", MONITORS)
def test_the_bound_holds_and_the_certificate_says_what_it_cost(name: str) -> None:
    solution = solved(MONITORS[name])
    assert measure_faces(solution.mesh).non_orthogonality <= BOUND
    assert solution.faces.non_orthogonality > 0.3 * BOUND or solution.relaxed[0].what == "rectilinear"
    assert solution.relaxed, "without a price the bound would be no bound for this monitor"
    (said,) = (text for text in solution.certificate.warnings if f"The bound of {BOUND:g} degrees" in text)
    assert solution.status in (em.Status.RELAXED, em.Status.COMPLETED)
    assert solution.problem.monitor == em.solve(solution.problem).problem.monitor
    assert said in solution.message


def test_a_uniform_mesh_that_a_bound_leaves_is_not_laid_on_the_monitor() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=STEEP, orthogonality=0.02), grid=em.Grid(n_xi=9, n_eta=9))
    (said,) = (text for text in em.solve(problem).certificate.warnings if "is uniform" in text)
    assert "the bound of 0.02 degrees of non-orthogonality leaves next to nothing" in said
    assert said.endswith("Raise orthogonality.")


def test_a_round_of_a_solver_keeps_the_bound() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    values = STEEP.evaluate(nodes.x, nodes.y)[0]
    u = em.NodalField(mesh=nodes, values=values)
    free, bounded = solved(em.NodalSolution(u=u)), solved(em.NodalSolution(u=u, orthogonality=BOUND))
    assert free.faces.non_orthogonality > BOUND >= bounded.faces.non_orthogonality
    assert bounded.estimate == free.estimate
    assert [text for text in bounded.certificate.warnings if f"The bound of {BOUND:g} degrees" in text]


def test_a_bound_that_holds_changes_nothing() -> None:
    for free in (em.ArcLength(u=em.Expression("tanh(5*(x - y))")), em.LeastError(u=em.Expression("exp(x*y)"))):
        plain = solved(free)
        bounded = solved(type(free)(u=free.u, orthogonality=plain.faces.non_orthogonality + 0.1))
        assert np.array_equal(bounded.mesh.x, plain.mesh.x)
        assert bounded.relaxed == plain.relaxed == ()
        assert bounded.status is plain.status


def test_it_holds_with_subdomains_and_on_a_bent_domain() -> None:
    front = em.Expression("tanh(20*(hypot(x, y) - 1.5 + 0.2*sin(5*x)))")
    arc = em.ArcLength(u=front, orthogonality=BOUND)
    for schwarz in (None, em.Schwarz(subdomains=(2, 1))):
        solution = solved(arc, schwarz, domain=em.AnnulusSector())
        assert 0.8 * BOUND < solution.faces.non_orthogonality <= BOUND
        assert solution.relaxed[0].what == "a"
        assert 0.0 < solution.relaxed[0].reached < solution.relaxed[0].asked
        assert solution.status is em.Status.RELAXED


def test_a_given_mesh_with_larger_angles_is_not_kept() -> None:
    free = solved(em.LeastError(u=STEEP))
    assert free.faces.non_orthogonality > BOUND
    for name in ("least_error", "arc_length"):
        assert solved(MONITORS[name], initial=free.reference).faces.non_orthogonality <= BOUND


@pytest.mark.everything
def test_a_target_reaches_its_error_within_the_bound() -> None:
    monitor = em.LeastError(u=em.Expression("tanh(9*(x - y*y))"), orthogonality=BOUND)
    aimed = em.solve_to(em.Target(error=2e-3), monitor=monitor)
    assert aimed.faces.non_orthogonality <= BOUND
    assert aimed.certificate.target.reached <= 2e-3


def test_a_domain_whose_uniform_mesh_is_beyond_the_bound_is_refused() -> None:
    sheared = em.Quadrilateral(
        bottom=em.Curve.through([[0, 0], [1, 0]]),
        right=em.Curve.through([[1, 0], [2, 1]]),
        top=em.Curve.through([[1, 1], [2, 1]]),
        left=em.Curve.through([[0, 0], [1, 1]]),
    )
    with pytest.raises(em.InputError, match="45 degrees on this domain already") as caught:
        solved(em.ArcLength(u=em.Expression("x*y"), orthogonality=40.0), domain=sheared)
    assert caught.value.field == "monitor.orthogonality"
    assert solved(em.ArcLength(u=em.Expression("x*y"), orthogonality=50.0), domain=sheared).status.succeeded


@pytest.mark.parametrize("bad", [0.0, -1.0, 91.0, float("nan"), True, "50"])
def test_a_bound_that_is_no_angle_is_refused(bad: Any) -> None:
    for make in (em.ArcLength, em.Curvature, em.LeastError, em.Auto):
        with pytest.raises(em.InputError, match="angle of non-orthogonality") as caught:
            make(u=STEEP, orthogonality=bad)
        assert caught.value.field == "orthogonality"


DIAGONAL = em.Expression("tanh(25*(x + 0.7*y - 0.1))")


@pytest.mark.parametrize("bound", [60.0, 45.0])
def test_on_blocks_oblique_corners_become_dearer_until_the_bound_holds(bound: float) -> None:
    domain = l_shape(1000)
    free = em.solve(em.Problem(monitor=em.LeastError(u=DIAGONAL), domain=domain))
    assert free.faces.non_orthogonality > 60.0
    monitor = em.LeastError(u=DIAGONAL, orthogonality=bound)
    solution = em.solve(em.Problem(monitor=monitor, domain=domain))
    assert solution.faces.non_orthogonality <= bound
    assert any("oblique corners" in text for text in solution.certificate.warnings)
    assert solution.interpolation is not None
    assert free.interpolation is not None
    assert 1.5 < solution.interpolation.gain_l2 < free.interpolation.gain_l2
    assert solution.angles.share_within > 0.99
    assert free.angles.share_within < 0.95


def test_on_blocks_the_initial_mesh_is_left_where_no_weight_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orthogonality, "OBLIQUENESS_TRIALS", ())
    monitor = em.LeastError(u=DIAGONAL, orthogonality=45.0)
    solution = em.solve(em.Problem(monitor=monitor, domain=l_shape(300)))
    assert solution.mesh is solution.initial
    assert "left no mesh but the initial one" in solution.note
