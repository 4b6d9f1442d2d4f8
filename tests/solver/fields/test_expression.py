"""Expressions as fields: shapes, equality, on the points of a domain, periodic, and finite on it."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.errors import ExpressionError, InputError
from equimesh.fields.expression import Expression, require_field
from equimesh.fields.on_domain import Inverse, OnDomain, recover, reference_on
from equimesh.fields.periodic import Periodic, repeated, repeated_field, within
from equimesh.testing import check_field
from solver.bent import CURVED
from solver.fields.bent_meshes import ANYWHERE, largest, smooth_mesh
from solver.formulas.texts import refused, values


def test_it_looks_at_the_domain() -> None:
    u = em.Expression("log(x)")
    u.check_finite(domain=em.Rectangle(x=(1, 2)))
    with pytest.raises(em.ExpressionError, match=r"at \(x, y\) = \(0, 0\)"):
        u.check_finite()
    with pytest.raises(em.ExpressionError, match=r"at \(x, y\) = \(0, 1\), because of log"):
        u.check_finite(domain=em.AnnulusSector())


def test_its_remedy_speaks_of_the_domain() -> None:
    with pytest.raises(em.ExpressionError, match="out of the domain"):
        em.Expression("atan2(y, x - 1.5)").check_finite(domain=em.AnnulusSector(angles=(-90, 90)))


def test_the_paper_function_and_its_derivatives() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 5), indexing="ij")
    results = Expression("(1-exp(15*(x-1)))*sin(pi*y)").evaluate(x, y, order=2)
    g, s, c = np.exp(15 * (x - 1)), np.sin(np.pi * y), np.cos(np.pi * y)
    expected = (
        (1 - g) * s,
        -15 * g * s,
        (1 - g) * np.pi * c,
        -225 * g * s,
        -15 * g * np.pi * c,
        -(1 - g) * np.pi**2 * s,
    )
    for result, wanted in zip(results, expected, strict=True):
        assert result.shape == x.shape
        np.testing.assert_allclose(result, wanted, rtol=1e-13, atol=1e-13)


def test_parameters_and_time_enter_as_numbers() -> None:
    u = Expression("k*x + t*ω", parameters={"k": 2, "ω": 3.0}, t=0.5)
    assert [float(part) for part in u.evaluate(0.25, 0.0, 1)] == [2.0, 2.0, 0.0]
    assert u.names == {"k", "x", "t", "ω"}
    with pytest.raises(ExpressionError) as caught:
        Expression("x", t=math.inf)
    assert caught.value.field == "t"


def test_an_expression_is_a_value() -> None:
    given = {"k": 1.0}
    u = Expression("k*x", parameters=given)
    given["k"] = 2.0
    assert values("k*x", 1.0, 0.0, 0, k=1.0) == [float(u.evaluate(1.0, 0.0)[0])]
    for twin in (pickle.loads(pickle.dumps(u)), copy.deepcopy(u)):
        assert twin == u
        assert hash(twin) == hash(u)
        assert float(twin.evaluate(0.5, 0.0)[0]) == 0.5
    assert u != Expression("k*x", parameters={"k": 3.0})
    with pytest.raises(TypeError):
        u.parameters["k"] = 5.0  # type: ignore[index]
    error = pickle.loads(pickle.dumps(refused("x%2")))
    assert error.position.offset == 1


def test_shapes() -> None:
    u = Expression("x + 2*y")
    assert u.evaluate(1.0, 2.0)[0].shape == ()
    assert u.evaluate(np.zeros((3, 1)), np.ones(4), 2)[5].shape == (3, 4)
    assert u.evaluate(np.zeros((0, 2)), np.zeros((0, 2)), 1)[1].shape == (0, 2)
    assert Expression("1").evaluate(np.zeros(3), np.zeros(3), 1)[0].tolist() == [1.0, 1.0, 1.0]
    assert u.evaluate([1, 2], [3, 4])[0].dtype == np.float64
    strided = np.linspace(0, 1, 12).reshape(3, 4).T
    np.testing.assert_array_equal(u.evaluate(strided, strided)[0], 3 * strided)
    with pytest.raises(InputError, match="0, 1 or 2"):
        u.evaluate(0.0, 0.0, order=3)


def test_check_finite_refuses_what_cannot_be_squared() -> None:
    with pytest.raises(ExpressionError, match=r"the gradient of u is larger than 1e\+100") as caught:
        Expression("y + 1e101*x").check_finite()
    assert caught.value.position.offset == 4


@pytest.mark.parametrize(
    "text",
    [
        "0",
        "(1-exp(15*(x-1)))*sin(pi*y)",
        "tanh(60*(sqrt((x-0.5)**2 + (y-0.5)**2) - 0.3))",
        "where(x > 0, x*log(x), 0)",
        "abs(x - 0.5) + max(x, y)",
        "hypot(x - 0.5, y - 0.5)",
        "1/(1 + exp(1000*(x - 0.5)))",
        "tanh(1e12*x) + tanh(1e6*(y - 1/3))",
        "1e90*x + y",
        "1/(1e-14 + (x - 0.33)**2)",
        "abs(x - 1/3)**1.5",
        "where(x < 1/3, 1, 1/(x - 0.3))",
        "1/(x - 1.0000001)",
    ],
)
def test_check_finite_accepts(text: str) -> None:
    Expression(text).check_finite()


def test_check_finite_sees_a_single_bad_point_of_its_grid() -> None:
    with pytest.raises(ExpressionError, match=r"not finite at \(x, y\) = \(0\.25, 0\.75\)"):
        Expression("1/((x - 0.25)**2 + (y - 0.75)**2)").check_finite(n=5)


# What is a field, and what is refused as one.


AXIS = np.linspace(0, 1, 5)


@pytest.mark.parametrize(
    "field",
    [
        em.Expression("x*y"),
        em.GridSamples(x=AXIS, y=AXIS, values=np.outer(AXIS, AXIS)),
        em.ScatteredSamples(points=[[0, 0], [0, 1], [1, 0], [1, 1]], values=[0, 0, 0, 1]),
    ],
    ids=lambda field: type(field).__name__,
)
def test_every_field_is_one(field: em.Expression) -> None:
    assert require_field(field, "u") is field
    for order, count in enumerate((1, 3, 6)):
        found = field.evaluate(AXIS[1:4], AXIS[1:4], order)
        assert [np.shape(part) for part in found] == [(3,)] * count


@pytest.mark.parametrize("wrong", [3.0, None, np.zeros(3), {"evaluate": 1}])
def test_anything_else_is_refused_with_what_to_write(wrong: object) -> None:
    with pytest.raises(em.InputError, match=r"give a formula as a text, or values as em\.GridSamples") as caught:
        require_field(wrong, "rho")
    assert caught.value.field == "rho"


def test_a_text_is_an_expression() -> None:
    assert require_field("x*y", "u") == em.Expression("x*y")
    tensor = em.Tensor(m11="1 + x", m12="0", m22="2", u="tanh(x)")  # type: ignore[arg-type]
    assert (tensor.m11, tensor.u) == (em.Expression("1 + x"), em.Expression("tanh(x)"))
    for monitor in (em.ArcLength, em.Curvature, em.LeastError, em.Auto):
        assert monitor(u="x*y").u == em.Expression("x*y")  # type: ignore[arg-type]
    weight = em.Weight(rho="1 + x", u="y")  # type: ignore[arg-type]
    assert (weight.rho, weight.u) == (em.Expression("1 + x"), em.Expression("y"))


def test_a_text_that_is_no_expression_names_the_function_and_the_column() -> None:
    with pytest.raises(em.ExpressionError, match="did you mean tanh") as caught:
        em.Weight(rho="1 + tnah(x)")  # type: ignore[arg-type]
    assert caught.value.field == "rho"
    assert caught.value.position.column == 5


SECTOR = em.AnnulusSector(radii=(1.0, 3.0), angles=(10.0, 100.0))
DOMAINS = [em.Rectangle(x=(-1.0, 3.0), y=(2.0, 2.5)), SECTOR, CURVED]


@pytest.mark.parametrize("domain", DOMAINS)
def test_the_inverse_gives_back_the_points_of_the_square(domain: em.Domain) -> None:
    assert largest(Inverse(domain=domain).at(*domain.map(*ANYWHERE)), tuple(ANYWHERE)).max() < 1e-12


def test_a_function_of_the_radius_is_one_of_s() -> None:
    field = OnDomain(reference=em.Expression("(1 + 2*x)**2"), domain=SECTOR)
    x, y = SECTOR.map(*ANYWHERE)
    exact = (x * x + y * y, 2.0 * x, 2.0 * y, np.full(500, 2.0), np.zeros(500), np.full(500, 2.0))
    assert largest(field.evaluate(x, y, order=2), exact).max() < 1e-8


def test_it_is_a_field() -> None:
    check_field(OnDomain(reference=em.Expression("sin(2*x)*exp(y)"), domain=SECTOR), ((1.0, 1.5), (1.0, 1.5)))


def test_points_outside_have_the_value_of_one_next_to_them() -> None:
    field = OnDomain(reference=em.Expression("x"), domain=SECTOR)
    assert abs(field.evaluate(np.array([0.7]), np.array([0.7]))[0]).max() < 1e-12


# u as a function of x and y from values at the nodes of a mesh of a domain.


NARROW_SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(-1.0, 2.0), y=(3.0, 3.5)), NARROW_SECTOR])
def test_the_mesh_of_the_square_is_found_from_that_of_the_domain(domain: em.Domain) -> None:
    square = smooth_mesh(12)
    found = reference_on(map_mesh(square, domain), domain)
    assert found.distance(square) < 1e-12
    assert {*found.x[0]} | {*found.y[:, 0]} == {0.0}


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0)), NARROW_SECTOR])
def test_the_function_has_the_values_at_the_nodes(domain: em.Domain) -> None:
    square = smooth_mesh(17)
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    values = np.sin(mesh.x) * mesh.y
    found = recover(mesh, values, domain)
    assert found.u.evaluate(mesh.x, mesh.y)[0] == pytest.approx(values, abs=1e-9)
    assert found.values == pytest.approx(values, abs=0.0)


DOMAIN = em.Rectangle(x=(-1.0, 1.0), y=(0.0, 1.0), periodic="x")


def test_points_are_moved_by_whole_periods() -> None:
    x, y = np.array([-3.5, -1.0, 0.25, 1.0, 2.5]), np.array([2.0, 0.0, 0.5, 1.0, -1.0])
    there = within(DOMAIN, x, y)
    assert np.allclose(there[0], [0.5, -1.0, 0.25, 1.0, 0.5], atol=1e-15)
    assert there[1] is y


def test_values_repeat_and_stay_to_the_last_bit_inside() -> None:
    u = em.Expression("sin(pi*x) + y*cos(2*pi*x)")
    field = repeated_field(u, DOMAIN, "u")
    x, y = np.array([-0.9, 0.3, 0.99]), np.array([0.1, 0.5, 0.7])
    assert np.array_equal(field.evaluate(x, y, 2), u.evaluate(x, y, 2))
    assert np.allclose(field.evaluate(x + 4.0, y, 2), u.evaluate(x, y, 2), atol=1e-10)


def test_a_function_that_jumps_is_refused_with_both_values() -> None:
    with pytest.raises(em.InputError, match=r"u is -1 and 1 where y = 0; take a u that repeats itself") as error:
        em.Problem(monitor=em.ArcLength(u=em.Expression("x")), grid=em.Grid(n_xi=9, n_eta=9), domain=DOMAIN)
    assert error.value.field == "domain.periodic"


def test_samples_are_joined_smoothly_across_the_seam() -> None:
    x, y = np.linspace(-1.0, 1.0, 21), np.linspace(0.0, 1.0, 9)
    samples = em.GridSamples(x=x, y=y, values=np.sin(np.pi * x)[:, None] * (1.0 + y), box=DOMAIN.box)
    field = repeated_field(samples, DOMAIN, "u")
    ends, middle = np.array([-1.0, 1.0]), np.full(2, 0.5)
    slopes = field.evaluate(ends, middle, 2)
    assert abs(slopes[1][0] - slopes[1][1]) < 1e-4 < abs(np.subtract(*samples.evaluate(ends, middle, 2)[1])) + 1e-3
    assert abs(slopes[3][0] - slopes[3][1]) < 0.02 * np.pi**2
    assert np.allclose(field.evaluate(x, np.full(21, y[3]))[0], samples.values[:, 3], atol=1e-13)


def test_all_functions_of_a_monitor_repeat_themselves_once() -> None:
    u = em.Expression("cos(pi*x)")
    monitor = em.Intersection(monitors=(em.Smoothed(monitor=em.Curvature(u=u)), em.Weight(rho=em.Expression("1+y"))))
    found = repeated(monitor, DOMAIN)
    assert isinstance(found.monitors[0].monitor.u, Periodic)
    assert isinstance(found.monitors[1].rho, Periodic)
    assert repeated(found, DOMAIN) is found
    assert repeated(monitor, em.Rectangle()) is monitor
