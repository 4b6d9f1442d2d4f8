"""From what a time-stepper gives to the monitor of the next mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError
from equimesh.sequences.pursuit import field_of, monitor_for, with_u

MESH = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
U = em.Expression("x*y")


def test_nodal_values_fields_and_texts_become_u_with_the_settings_of_the_template() -> None:
    template = em.Smoothed(monitor=em.Curvature(u=U, norm="h1"), radius=0.03)
    for given in (MESH.x, U, "x + y"):
        monitor = monitor_for(template, given, MESH)
        assert isinstance(monitor, em.Smoothed)
        assert monitor.radius == 0.03
        assert isinstance(monitor.monitor, em.Curvature)
        assert monitor.monitor.norm == "h1"
    assert monitor_for(em.Auto(u=U), MESH.x, MESH).u.values is not None


def test_a_monitor_is_taken_as_it_is() -> None:
    other = em.Weight(rho=em.Expression("1 + x"))
    assert monitor_for(em.Auto(u=U), other, MESH) is other


def test_several_u_are_intersected() -> None:
    template = em.ArcLength(u=U, a=0.3)
    for given in ({"u": MESH.x, "v": "sin(y)"}, (MESH.x, U), [em.Curvature(u=U), "x"]):
        monitor = monitor_for(template, given, MESH)
        assert isinstance(monitor, em.Intersection)
        assert len(monitor.monitors) == 2
    assert isinstance(monitor_for(template, [list(row) for row in MESH.x], MESH), em.ArcLength)  # rows of one array
    assert isinstance(monitor_for(template, {"u": U}, MESH), em.ArcLength)


def test_smoothed_curvature_stands_for_least_error_in_an_intersection() -> None:
    monitor = monitor_for(em.LeastError(u=U, norm="h1"), (MESH.x, U), MESH)
    assert isinstance(monitor, em.Intersection)
    for member in monitor.monitors:
        assert isinstance(member, em.Smoothed)
        assert isinstance(member.monitor, em.Curvature)
        assert member.monitor.norm == "h1"


def test_members_of_an_intersection_follow_the_same_u_and_a_weight_is_u() -> None:
    both = em.Intersection(monitors=(em.ArcLength(u=U), em.Weight(rho=em.Expression("1 + x"))))
    moved = with_u(both, em.Expression("2 + y"))
    assert isinstance(moved, em.Intersection)
    assert moved.monitors[0].u == moved.monitors[1].rho


def test_what_follows_nothing_is_refused() -> None:
    one = em.Expression("1")
    with pytest.raises(InputError, match="give each step a monitor"):
        with_u(em.Tensor(m11=one, m12=em.Expression("0"), m22=one), U)
    with pytest.raises(InputError, match=r"9 x 9|needed"):
        field_of(np.zeros((4, 4)), MESH, "u")


def test_auto_follows_the_error_of_interpolation() -> None:
    u, grid = em.Expression("tanh(20*(x + y/2 - 0.75))"), em.Grid(n_xi=17, n_eta=17)
    followed = em.Sequence(em.Problem(monitor=em.Auto(u=u), grid=grid)).mesh
    alone = {
        purpose: em.solve(em.Problem(monitor=em.Auto(u=u, purpose=purpose), grid=grid), threads=1).mesh  # type: ignore[arg-type]
        for purpose in ("interpolation", "finite_element")
    }
    assert followed.distance(alone["interpolation"]) == 0.0
    assert followed.distance(alone["finite_element"]) > 0.0
