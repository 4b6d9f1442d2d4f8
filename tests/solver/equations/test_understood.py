"""The formulas of a problem that were typed in another spelling, wherever they are in it."""

from __future__ import annotations

import equimesh as em
from equimesh.equations.problem import understood

GRID = em.Grid(n_xi=5, n_eta=5)


def test_formulas_in_the_language_are_left_out() -> None:
    monitor = em.Weight(rho=em.Expression("1 + x**2"), u=em.Expression("x*y"))
    assert understood(em.Problem(monitor=monitor, grid=GRID)) == {}


def test_formulas_are_named_by_their_place() -> None:
    side = em.Curve.of_expressions("t", "0.2 sin(πt)")
    left, right = em.Curve.through([(0, 0), (0, 1)]), em.Curve.through([(1, 0), (1, 1)])
    top = em.Curve.through([(0, 1), (1, 1)])
    domain = em.Quadrilateral(bottom=side, top=top, left=left, right=right)
    arc = em.ArcLength(u=em.Expression("2x"))
    both = em.Intersection(monitors=(em.Curvature(u=em.Expression("x^2")), em.Curvature(u=em.Expression("y**2"))))
    assert understood(em.Problem(monitor=arc, domain=domain, grid=GRID)) == {
        "monitor.u": "2*x",
        "domain.bottom.y": "0.2*sin(pi*t)",
    }
    assert understood(em.Problem(monitor=both, grid=GRID)) == {"monitor.monitors[0].u": "x**2"}


def test_the_certificate_tells_them() -> None:
    typed = em.solve(em.Problem(monitor=em.ArcLength(u=em.Expression("x^2")), grid=GRID))
    plain = em.solve(em.Problem(monitor=em.ArcLength(u=em.Expression("x**2")), grid=GRID))
    assert typed.certificate.understood == {"monitor.u": "x**2"}
    assert typed.certificate.summary()["understood"] == {"monitor.u": "x**2"}
    assert plain.certificate.understood == {}
    assert (typed.mesh.x == plain.mesh.x).all()
