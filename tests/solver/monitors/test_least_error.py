"""The request for a least-error mesh: its values, its metric, its copies."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import SECTOR, UNIT, points

STEEP = em.Expression("tanh(20*(x + y/2 - 0.75))")


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_its_metric_is_that_of_curvature(norm: Any) -> None:
    x, y = points(n=9)
    own = em.LeastError(u=STEEP, norm=norm).on(UNIT).metric(x, y)
    assert np.array_equal(own, em.Curvature(u=STEEP, norm=norm).on(UNIT).metric(x, y))


def test_the_defaults() -> None:
    monitor = em.LeastError(u=STEEP)
    assert (monitor.norm, monitor.cells, monitor.distortion, monitor.smoothness) == ("l2", "quad", 0.5, 1.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("norm", "linf"),
        ("norm", None),
        ("cells", "hexagon"),
        ("distortion", 0.0),
        ("distortion", -1.0),
        ("distortion", float("nan")),
        ("distortion", "1"),
        ("smoothness", 0.0),
        ("smoothness", 1001.0),
        ("smoothness", float("inf")),
        ("degree", 0),
        ("degree", 5),
        ("degree", 2.0),
        ("degree", True),
        ("u", 3.0),
        ("u", "tanh(x"),
    ],
)
def test_what_is_refused_names_its_field(field: str, value: Any) -> None:
    with pytest.raises(em.InputError) as caught:
        em.LeastError(**({"u": STEEP} | {field: value}))
    assert caught.value.field == field


@pytest.mark.parametrize("field", ["distortion", "smoothness", "obliqueness"])
def test_a_number_in_words_is_shown_as_a_text(field: str) -> None:
    with pytest.raises(em.InputError, match=f"{field} = '1': the weight"):
        em.LeastError(**{"u": STEEP, field: "1"})


def test_triangles_have_elements_of_degree_1_and_2() -> None:
    assert em.LeastError(u=STEEP, degree=2, cells="triangle").degree == 2
    for kind in (em.LeastError, em.Auto):
        with pytest.raises(em.InputError, match="on triangles elements have degree 1 or 2") as caught:
            kind(u=STEEP, degree=3, cells="triangle")
        assert caught.value.field == "degree"


def test_the_metric_needs_a_domain_and_binding_keeps_the_rest() -> None:
    monitor = em.LeastError(u=STEEP, norm="h1", distortion=0.2, smoothness=0.3, cells="triangle")
    with pytest.raises(em.InputError, match="on\\(domain\\)"):
        monitor.metric(*points(n=2))
    bound = monitor.on(UNIT)
    assert bound == monitor
    assert bound.on(UNIT) is bound
    assert bound.on(SECTOR) is not bound
    assert pickle.loads(pickle.dumps(bound)) == monitor


@pytest.mark.parametrize(("u", "norm"), [("log(x - 0.5)", "l2"), ("sqrt(y - 0.25)", "l2"), ("(x - 0.5)**1.5", "h1")])
def test_u_must_be_finite_on_the_domain(u: str, norm: Any) -> None:
    with pytest.raises(em.InputError) as caught:
        em.LeastError(u=em.Expression(u), norm=norm).on(UNIT)
    assert caught.value.field == "u"


@pytest.mark.parametrize("kind", [em.LeastError, em.Curvature])
@pytest.mark.parametrize("factor", [1e300, 1e145, 1e-145, 1e-310])
def test_squares_of_u_must_be_numbers(kind: Any, factor: float) -> None:
    with pytest.raises(em.InputError, match="multiply u by a constant") as caught:
        kind(u=em.Expression(f"{factor!r}*(x*x + 2)")).on(UNIT)
    assert caught.value.field == "u"
    kind(u=em.Expression("0*x")).on(UNIT)
    kind(u=em.Expression(f"{factor**0.3!r}*(x*x + 2)")).on(UNIT)


def front(mesh: em.Mesh, t: float = 0.0) -> Any:
    return np.tanh(40.0 * (mesh.x - 0.4 * mesh.y - 0.3 - t))


@pytest.mark.parametrize("kind", [em.LeastError, em.Auto])
@pytest.mark.parametrize("domain", [UNIT, SECTOR, em.Rectangle(periodic="y")])
def test_values_at_nodes_are_interpolated_without_overshoots(kind: Any, domain: Any) -> None:
    s = np.linspace(0.0, 1.0, 17)
    s, t = np.meshgrid(s, s, indexing="ij")
    mesh = em.Mesh(*domain.map(s, t))
    values = np.tanh(40.0 * (s - 0.45))
    u = em.NodalField(mesh=mesh, values=values)
    between = domain.map(*np.meshgrid(np.linspace(0.0, 1.0, 100), np.linspace(0.0, 1.0, 100), indexing="ij"))
    assert u.evaluate(*between)[0].max() > 1.01
    bound = em.Problem(monitor=kind(u=u), grid=em.Grid(n_xi=9, n_eta=9), domain=domain).monitor.u
    limited = bound.evaluate(*between)[0]
    assert abs(limited).max() <= 1.0 + 1e-12
    assert abs(bound.evaluate(mesh.x, mesh.y)[0] - values).max() < 1e-7


def test_values_at_nodes_of_another_domain_are_taken_as_they_are() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    wide = em.Mesh(4.0 * mesh.x - 2.0, 4.0 * mesh.y - 2.0)
    u = em.NodalField(mesh=wide, values=front(wide))
    assert em.LeastError(u=u).on(SECTOR).u is u


def test_a_sequence_keeps_the_gain_for_the_function_whose_values_it_is_given() -> None:
    grid = em.Grid(n_xi=25, n_eta=25)
    first = em.Mesh.uniform(grid)
    meshes = em.Sequence(em.Problem(monitor=em.LeastError(u=em.Expression("x")), grid=grid), mesh=first)
    for number in range(6):
        meshes.step(front(meshes.mesh, 0.02 * number))
    exact = em.ArcLength(u=em.Expression("tanh(40*(x - 0.4*y - 0.4))")).on(UNIT)
    errors = em.measure(meshes.mesh, exact).interpolation_error
    assert errors.gain_l2 > 15.0  # a spline through the values leaves 6
