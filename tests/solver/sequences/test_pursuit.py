"""The solve of one step: what it begins with, what it follows, and where u has outrun its cells."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError
from equimesh.sequences.pursuit import Pursuit, field_of, gain_of, monitor_for, with_u
from equimesh.sequences.sequence import check_settings, first_mesh
from equimesh.testing.geometries import l_shape
from solver.fields.bent_meshes import smooth_mesh

FRONT = "tanh(30*(x + y/2 - 0.6 - t))"
GRID = em.Grid(n_xi=17, n_eta=17)


def problem(t: float, kind: Any = em.LeastError) -> em.Problem:
    return em.Problem(monitor=kind(u=em.Expression(FRONT, t=t)), grid=GRID)


def pursuit(start: em.Solution, **changes: Any) -> Pursuit:
    known: dict[str, Any] = {"u": start.problem.monitor.u, "gain": gain_of(start), "max_move": 1.0}
    known["options"] = {"threads": 1}
    return Pursuit(schwarz=None, before=start.reference, **{**known, **changes})


def test_a_front_that_jumps_is_found_by_another_start() -> None:
    start = em.solve(problem(0.0), threads=1)
    far = pursuit(start).solve(problem(0.15))
    direct = em.solve(problem(0.15), initial=start.reference, threads=1)
    assert far.gain >= gain_of(direct)
    assert far.gain > 0.5 * gain_of(start)
    assert far.substeps == 1


def test_the_mesh_before_is_enough_for_a_small_move() -> None:
    start = em.solve(problem(0.0), threads=1)
    near = pursuit(start, gain=1.0, max_move=math.inf).solve(problem(0.001))
    assert near.gain == gain_of(em.solve(problem(0.001), initial=start.reference, threads=1))


def test_a_mesh_that_has_kept_its_gain_stays_near_however_far_it_moved() -> None:
    start = em.solve(problem(0.0), threads=1)
    near = pursuit(start, gain=1.0, max_move=1e-6).solve(problem(0.02))
    direct = em.solve(problem(0.02), initial=start.reference, threads=1)
    assert near.solution.mesh.distance(direct.mesh) == 0.0
    grids = {}
    for gain in (1.0, math.nan):
        seen: list[Any] = []
        pursuit(start, gain=gain, max_move=1e-6, options={"threads": 1, "observe": seen.append}).solve(problem(0.02))
        grids[gain] = sum(event.grid == GRID and event.step == 0 for event in seen)
    assert grids[1.0] == 1
    assert sum(grids.values()) > 2  # where the gain is not known, a nested start is tried, too


def test_substeps_are_taken_where_the_error_stays_large() -> None:
    seen: list[Any] = []
    start = em.solve(problem(0.0), threads=1)
    options: em.solving.options.SolveArguments = {"threads": 1, "observe": lambda event: seen.append(event)}
    chase = Pursuit(
        schwarz=None, options=options, before=start.reference, u=start.problem.monitor.u, gain=1e9, max_move=2.0
    )
    found = chase.solve(problem(0.1))
    finest = [event for event in seen if event.grid == GRID and event.step == 0]
    assert len(finest) > 4
    assert found.gain >= gain_of(em.solve(problem(0.1), threads=1)) * (1 - 1e-12)


def test_a_monitor_without_u_has_no_gain() -> None:
    solution = em.solve(em.Problem(monitor=em.Weight(rho=em.Expression("1 + x")), grid=GRID), threads=1)
    assert math.isnan(gain_of(solution))
    found = pursuit(solution, max_move=1e-9).solve(
        em.Problem(monitor=em.Weight(rho=em.Expression("1 + 3*y")), grid=GRID)
    )
    assert found.solution.status.succeeded


def test_on_blocks_the_same_starts_are_tried() -> None:
    domain = l_shape(300)

    def on_blocks(t: float) -> em.Problem[em.Blocks]:
        return em.Problem(monitor=em.LeastError(u=em.Expression("tanh(12*(x + y - 0.8 - t))", t=t)), domain=domain)

    start = em.solve(on_blocks(0.0), threads=1)
    known: dict[str, Any] = {"options": {"threads": 1}, "before": start.mesh, "u": start.problem.monitor.u}
    near = Pursuit(**known, gain=1.0, max_move=9.0).solve(on_blocks(0.02))
    assert near.solution.mesh.distance(em.solve(on_blocks(0.02), initial=start.mesh, threads=1).mesh) == 0.0
    far = Pursuit(**known, gain=1e9, max_move=0.5).solve(on_blocks(0.4))
    assert far.gain >= gain_of(em.solve(on_blocks(0.4), threads=1))


RING = em.AnnulusSector()
FLAT = em.Problem(monitor=em.Weight(rho=em.Expression("1 + x")), grid=em.Grid(n_xi=9, n_eta=9))


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"smoothing": "a"}, "smoothing"),
        ({"smoothing": None}, "smoothing"),
        ({"smoothing": 1.0}, "smoothing"),
        ({"max_move": None}, "max_move"),
        ({"max_move": -1}, "max_move"),
        ({"outrun": None}, "outrun"),
    ],
)
def test_settings_of_another_kind_are_refused(changed: dict[str, Any], field: str) -> None:
    good: dict[str, Any] = {"smoothing": 0, "max_move": np.float32(2.0), "outrun": "refuse"}
    check_settings(**good)
    with pytest.raises(InputError, match=f"{field} = ") as caught:
        check_settings(**{**good, **changed})
    assert caught.value.field == field


@pytest.mark.parametrize("domain", [RING, em.Rectangle(x=(2.0, 5.0)), em.AnnulusSector(angles=(0, 360))])
def test_a_mesh_of_the_domain_comes_with_its_reference(domain: em.Domain) -> None:
    plain = smooth_mesh(17, depth=0.02)
    square = em.Mesh(plain.x, plain.y**2)  # there are inner nodes near the cut of the full ring
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    found, reference = first_mesh(mesh, domain)
    assert found is mesh
    assert reference.distance(square) < 1e-9


def test_a_mesh_of_another_domain_is_refused() -> None:
    square = smooth_mesh(9)
    for mesh in (em.Mesh(0.9 * square.x, square.y), em.Mesh(square.x + 10.0, square.y), map_mesh(square, RING)):
        with pytest.raises(InputError, match="one of the problem's domain"):
            first_mesh(mesh, em.Rectangle())
    solution = em.solve(FLAT, threads=1)
    assert first_mesh(solution, FLAT.domain) == (solution.mesh, solution.reference)
    with pytest.raises(InputError, match="one of the problem's domain"):
        first_mesh(solution, RING)


@pytest.mark.parametrize("begin", [None, "x", np.zeros((9, 9, 2))])
def test_what_is_no_mesh_is_refused(begin: Any) -> None:
    with pytest.raises(InputError, match="cannot begin with"):
        first_mesh(begin, em.Rectangle())


def test_a_sequence_begins_with_one_thing_alone() -> None:
    solution = em.solve(FLAT, threads=1)
    with pytest.raises(InputError, match="and not both"):
        em.Sequence(FLAT, solution=solution, mesh=solution.mesh)
    with pytest.raises(InputError, match="cannot begin with the text 'x'"):
        em.Sequence(FLAT, mesh="x")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="u is the class LeastError"):
        em.Sequence(FLAT, solution=solution).step(em.LeastError)
    with pytest.raises(InputError, match="u = 'None' cannot be evaluated here"):
        em.Sequence(FLAT, solution=solution).step(None)


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
