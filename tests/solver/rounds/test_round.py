"""One round from nodal values to the next mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.errors import InputError, SamplesError
from equimesh.least_error.kernels import Norm, Rule
from equimesh.meshes.second_order import lattice_of
from equimesh.rounds.candidates import Search
from equimesh.rounds.recovery import KEPT, Recovery, Round, measured
from equimesh.rounds.round import adapt_round

FRONT = em.Expression("tanh(20*(x + y/2 - 0.75))")
SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


def uniform(n: int, m: int, domain: em.Domain = UNIT_SQUARE) -> em.Mesh:
    return map_mesh(em.Mesh.uniform(em.Grid(n_xi=n, n_eta=m)), domain)


def first_round(n: int, m: int, u: em.Field = FRONT, domain: em.Domain = UNIT_SQUARE, **settings: object) -> Round:
    mesh = uniform(n, m, domain)
    return adapt_round(mesh, u.evaluate(mesh.x, mesh.y)[0], domain, **settings)


@pytest.mark.parametrize(
    ("domain", "u", "gain"),
    [
        (UNIT_SQUARE, FRONT, 4.0),
        (em.Rectangle(x=(0.0, 2.0), y=(-1.0, 0.0)), em.Expression("tanh(10*(x + y - 0.6))"), 3.0),
        (SECTOR, em.Expression("tanh(20*(x + y/2 - 1.6))"), 3.0),
        (SECTOR, em.Expression("exp(-50*(sqrt(x**2 + y**2) - 1))"), 8.0),
    ],
)
def test_the_next_mesh_has_a_smaller_error_of_the_true_solution(domain: em.Domain, u: em.Field, gain: float) -> None:
    mesh, found = uniform(33, 25, domain), first_round(33, 25, u, domain)
    errors = [measured(u, domain, one, Rule(norm="l2")) for one in (em.Mesh.uniform(mesh.grid), found.reference)]
    assert errors[0] > gain * errors[1]
    assert found.mesh.min_jacobian > 0
    assert found.mesh.distance(map_mesh(found.reference, domain)) == 0.0
    assert found.chosen in found.candidates
    assert found.moved_cells > 0.3
    assert found.gain > 0.5 * gain
    assert 0.0 < found.unresolved < 0.3


def test_a_round_replays_bit_by_bit_on_any_number_of_threads() -> None:
    one, again, threads = first_round(33, 33), first_round(33, 33), first_round(33, 33, threads=3)
    for other in (again, threads):
        assert np.array_equal(one.mesh.x, other.mesh.x)
        assert np.array_equal(one.mesh.y, other.mesh.y)
        assert (one.estimate, one.candidates) == (other.estimate, other.candidates)


def test_the_norm_decides_what_is_measured() -> None:
    l2, h1 = first_round(17, 17), first_round(17, 17, norm="h1")
    assert (l2.estimate, l2.estimate_h1) == (h1.estimate, h1.estimate_h1)
    assert h1.mesh.distance(l2.mesh) > 0.01
    slopes = [measured(FRONT, UNIT_SQUARE, one.reference, Rule(norm="h1")) for one in (l2, h1)]
    assert slopes[1] < slopes[0]


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_gain_compares_errors_of_one_rule(norm: Norm) -> None:
    mesh = uniform(17, 17)
    found = first_round(17, 17, norm=norm)
    u = Recovery.of(mesh, FRONT.evaluate(mesh.x, mesh.y)[0], UNIT_SQUARE).u
    search = Search(u=u, domain=UNIT_SQUARE, before=mesh, norm=norm)
    assert found.gain == pytest.approx(search.error_on(mesh) / search.error_on(found.reference), rel=1e-12)


@pytest.mark.parametrize("values", [0.0, 7.5])
def test_constant_values_keep_the_mesh(values: float) -> None:
    mesh = uniform(9, 9)
    found = adapt_round(mesh, np.full((9, 9), values))
    assert found.chosen == KEPT
    assert found.mesh is mesh
    assert (found.gain, found.moved_cells) == (1.0, 0.0)
    assert found.estimate < 1e-13


def test_bad_arguments_are_refused() -> None:
    mesh = uniform(9, 9)
    with pytest.raises(SamplesError, match="values has shape"):
        adapt_round(mesh, np.ones((8, 9)))
    with pytest.raises(InputError, match="choose 'l2' or 'h1'"):
        adapt_round(mesh, np.ones((9, 9)), norm="linf")
    with pytest.raises(InputError, match="threads = 0"):
        adapt_round(mesh, np.ones((9, 9)), threads=0)


def test_the_unresolved_share_of_a_layer_within_one_cell_is_large() -> None:
    assert first_round(17, 17, em.Expression("tanh(500*(x + y/2 - 0.75))")).unresolved > 0.12
    assert first_round(33, 33, em.Expression("tanh(5*(x + y/2 - 0.75))")).unresolved < 0.05


# Values of elements of degree 2.


def quadratic_round(n: int, u: em.Field, domain: em.Domain = UNIT_SQUARE, **settings: object) -> Round:
    nodes = lattice_of(uniform(n, n, domain))
    return adapt_round(uniform(n, n, domain), u.evaluate(nodes.x, nodes.y)[0], domain, degree=2, **settings)


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize(
    ("domain", "u"),
    [(UNIT_SQUARE, FRONT), (SECTOR, em.Expression("tanh(20*(x + y/2 - 1.6))"))],
    ids=["square", "ring"],
)
def test_the_next_mesh_is_better_for_quadratic_elements(domain: em.Domain, u: em.Field, norm: Norm) -> None:
    found, rule = quadratic_round(17, u, domain, norm=norm), Rule(norm=norm, points=5, degree=2)
    before, after = (measured(u, domain, one, rule) for one in (em.Mesh.uniform(em.Grid(17)), found.reference))
    assert before > 3.0 * after
    known = found.estimate if norm == "l2" else found.estimate_h1
    assert known == pytest.approx(before, rel=0.5)


def test_the_estimate_for_quadratic_elements_is_that_of_their_interpolant() -> None:
    smooth = em.Expression("sin(3*x)*cos(2*y)")
    found = quadratic_round(17, smooth)
    for norm, estimate in (("l2", found.estimate), ("h1", found.estimate_h1)):
        true = measured(smooth, UNIT_SQUARE, em.Mesh.uniform(em.Grid(17)), Rule(norm=norm, points=5, degree=2))
        assert estimate == pytest.approx(true, rel=0.03)
    lattice = lattice_of(em.Mesh.uniform(em.Grid(17)))
    cubic = Recovery.of(uniform(17, 17), lattice.x**2 - lattice.x * lattice.y, UNIT_SQUARE, 2)
    assert cubic.gradient_norm() == pytest.approx(np.sqrt(4 / 3 - 1 + 1 / 3 + 1 / 3), rel=1e-12)  # (2x - y, -x)


def test_a_quadratic_solution_keeps_the_mesh_of_quadratic_elements() -> None:
    found = quadratic_round(9, em.Expression("x*x - 3*x*y + y"))
    assert (found.chosen, found.estimate) == (KEPT, 0.0)


def test_values_of_another_degree_are_refused_with_the_shape_that_is_needed() -> None:
    mesh = uniform(9, 7)
    with pytest.raises(SamplesError, match=r"shape \(9, 7\), and elements of degree 2 have nodes of shape \(17, 13\)"):
        adapt_round(mesh, mesh.x, degree=2)
    with pytest.raises(InputError, match="degree = 3: give 1 or 2, the degree of the elements at whose nodes"):
        adapt_round(mesh, mesh.x, degree=3)
