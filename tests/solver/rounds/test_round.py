"""One round from nodal values to the next mesh: recovery, candidates, and the shape of a grid."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.errors import InputError, SamplesError
from equimesh.fields.on_domain import OnDomain
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.starts import mesh_of, rectilinear
from equimesh.meshes.second_order import lattice_of, require_degree
from equimesh.quality.measures import measure_errors
from equimesh.quality.ritz import projection
from equimesh.rounds import recovery
from equimesh.rounds.candidates import LINE_FLOORS, LINES, MAX_CLIMBING, SAMPLED, STRAIGHT, Search
from equimesh.rounds.estimate import EarlierValues, ErrorEstimate, are_of_poisson
from equimesh.rounds.next_mesh import KEPT, NextMesh, Round, moved_cells
from equimesh.rounds.norms import measured
from equimesh.rounds.recovery import Recovery
from equimesh.rounds.round import adapt_round
from equimesh.rounds.shape import (
    GRID,
    FixedPoints,
    ShapeSearch,
    best_counts,
    counts_within,
    least_counts,
    on_grid,
    require_budget,
    with_counts,
)
from solver.fields.bent_meshes import smooth_mesh

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
    mesh, blocks = uniform(9, 9), em.Blocks.rectangle(cells=(4, 4)).mesh
    folded = em.Mesh(mesh.x[::-1].copy(), mesh.y)
    for other, given in ((mesh, mesh.x[:8]), (mesh, np.nan * mesh.x), (folded, mesh.x), (blocks, blocks.x)):
        with pytest.raises(InputError, match="the earlier values are not those at the nodes"):
            adapt_round(mesh, mesh.x, earlier=EarlierValues(other, given))
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
    ("domain", "u"), [(UNIT_SQUARE, FRONT), (SECTOR, em.Expression("tanh(20*(x + y/2 - 1.6))"))], ids=["square", "ring"]
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
    with pytest.raises(SamplesError, match="give values at the nodes on edges and in cells, too"):
        adapt_round(mesh, mesh.x, degree=3)  # where they are no middles
    with pytest.raises(InputError, match="degree = 5: give 1 to 4, the degree of the elements at whose nodes"):
        adapt_round(mesh, mesh.x, degree=5)
    with pytest.raises(InputError, match="degree = '2': give 1 to 4"):
        adapt_round(mesh, mesh.x, degree="2")  # type: ignore[arg-type]


@pytest.mark.parametrize("domain", [em.Rectangle(x=(0, 2)), em.Rectangle(y=(-3, -2)), em.AnnulusSector()])
def test_a_grid_of_another_domain_is_refused(domain: em.Domain) -> None:
    mesh = uniform(9, 7)
    with pytest.raises(InputError, match=r"of another domain, such as Rectangle\(x=\(0, 1\), y=\(0, 1\)\): give that"):
        adapt_round(mesh, mesh.x, domain)
    own = map_mesh(mesh, domain)
    assert adapt_round(own, own.x, domain).mesh.distance(own) < 1.0


def test_a_round_has_all_numbers_of_the_next_mesh() -> None:
    names = {field.name for field in dataclasses.fields(NextMesh)}
    assert names < {field.name for field in dataclasses.fields(Round)}
    assert em.Round is Round


SLOPED_FRONT = em.Expression("tanh(8*(x + y/2 - 0.75))")


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0)), SECTOR])
def test_the_estimate_is_the_error_where_the_mesh_resolves_u(domain: em.Domain, norm: str) -> None:
    square = smooth_mesh(33)
    mesh = map_mesh(em.Mesh.of_unit_square(square.x, square.y), domain)
    known = Recovery.of(mesh, SLOPED_FRONT.evaluate(mesh.x, mesh.y)[0], domain)
    exact = measured(SLOPED_FRONT, domain, known.mesh, Rule(norm=norm), of_solver=norm == "l2")
    assert 0.8 < known.estimate(norm) / exact < 1.3


def test_moves_are_measured_in_spacings() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=9))
    assert moved_cells(mesh, em.Mesh(mesh.x + 0.25, mesh.y)) == pytest.approx(1.0)
    assert moved_cells(mesh, em.Mesh(mesh.x, mesh.y + 0.25)) == pytest.approx(2.0)
    assert moved_cells(mesh, mesh) == 0.0
    assert np.isfinite(moved_cells(mesh, em.Mesh(mesh.x * 0.5, mesh.y)))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, em.Rectangle(x=(0.0, 2.0), y=(1.0, 1.5)), SECTOR])
def test_the_norm_of_the_gradient_is_that_of_a_linear_function(domain: em.Domain) -> None:
    mesh = map_mesh(em.Mesh.uniform(em.Grid(n_xi=33, n_eta=40)), domain)
    known = Recovery.of(mesh, 3.0 * mesh.x - 4.0 * mesh.y, domain)
    assert known.gradient_norm() == pytest.approx(5.0 * np.sqrt(domain.area), rel=1e-3)


NAMES = [*(name for name, *_ in SAMPLED), LINES, STRAIGHT]
STEEP_FRONT, LAYERS = em.Expression("tanh(20*(x + y/2 - 0.75))"), em.Expression("exp(50*(x - 1)) + exp(50*(y - 1))")


def search(u: em.Field, n: int, m: int, norm: str = "l2") -> Search:
    return Search(u=u, domain=UNIT_SQUARE, before=em.Mesh.uniform(em.Grid(n_xi=n, n_eta=m)), norm=norm)


@pytest.mark.parametrize(("u", "degree", "squared"), [("x + 2*y", 1, 5.0), ("x**2 + x*y", 2, 3.0)])
@pytest.mark.parametrize("blocks", [False, True])
def test_the_norm_of_the_gradient_on_triangles_is_exact(u: str, degree: int, squared: float, blocks: bool) -> None:
    domain = em.Blocks.rectangle(cells=(4, 4)) if blocks else UNIT_SQUARE
    mesh = domain.mesh if isinstance(domain, em.Blocks) else smooth_mesh(5)
    nodes = mesh if degree == 1 else lattice_of(mesh, degree, "triangle")
    values = em.Expression(u).evaluate(nodes.x, nodes.y)[0]
    known = Recovery.of(mesh, values, domain, require_degree(degree), "triangle")
    assert known.gradient_norm() == pytest.approx(np.sqrt(squared))


def test_candidates_are_measured_on_the_triangles_of_the_cut() -> None:
    mesh, rule = uniform(9, 9), Rule(norm="h1", cells="triangle", degree=2)
    search = Search(u=FRONT, domain=UNIT_SQUARE, before=mesh, norm="h1", degree=2, cells="triangle")
    assert search.error_on(mesh) == measured(FRONT, UNIT_SQUARE, mesh, rule)


def test_the_best_of_the_candidates_have_their_measured_errors() -> None:
    found = list(search(STEEP_FRONT, 33, 33).candidates())
    names = [one.name for one in found]
    assert len(names) == len({*names}) == MAX_CLIMBING + 1
    assert {*names} < {*NAMES}
    for one in found:
        mesh = mesh_of(one.mesh, em.Grid(n_xi=33, n_eta=33))
        assert mesh.min_jacobian > 0
        assert one.error == pytest.approx(measure_errors(mesh, STEEP_FRONT).l2, rel=0.15)


def test_straight_lines_are_as_good_as_any_for_layers_and_poor_for_an_oblique_front() -> None:
    for u, low, high in ((STEEP_FRONT, 2.0, 20.0), (LAYERS, 1.0, 1.3)):
        errors = {one.name: one.error for one in search(u, 33, 33).candidates()}
        assert low <= errors[STRAIGHT] / min(errors.values()) <= high


def test_the_last_steps_lower_the_error() -> None:
    here = search(STEEP_FRONT, 33, 25)
    best = min(here.candidates(), key=lambda one: one.error)
    finished = here.finished(best)
    assert finished.error < 0.97 * best.error
    assert not mesh_of(finished.mesh, here.before.grid).is_folded


def test_a_solver_leads_where_its_error_is_above_that_of_the_interpolant() -> None:
    mesh = uniform(17, 17)
    known = ErrorEstimate.of(mesh, STEEP_FRONT.evaluate(mesh.x, mesh.y)[0], UNIT_SQUARE)
    plain = known.recovery.estimate("l2", of_solver=False)
    assert known.solver_share == known.estimate / plain < 1.0
    cases = {(0.3, 0.8): False, (0.2, 0.8): False, (0.1, 0.8): True, (0.3, 1.2): True}
    found = [dataclasses.replace(known, unresolved=left, solver_share=share) for left, share in cases]
    assert [one.is_for_solver for one in found] == list(cases.values())


def test_no_error_of_the_values_is_measured_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    called = list[tuple[str, bool]]()

    def counting(*given: Any, plain: float | None = None, **of: Any) -> float:
        called.append((given[3].norm, plain is not None))
        return measured(*given, plain=plain, **of)

    monkeypatch.setattr(recovery, "measured", counting)
    for degree in (1, 2):
        nodes = uniform(8 * degree + 1, 8 * degree + 1)
        values = STEEP_FRONT.evaluate(nodes.x, nodes.y)[0]
        ErrorEstimate.of(uniform(9, 9), values, UNIT_SQUARE, degree=degree)
        assert sorted(called) == [("h1", False), ("l2", False), ("l2", True)]
        called.clear()


def test_a_solver_leads_no_more_where_its_earlier_values_are_not_those_for_poisson() -> None:
    mesh, first, u = uniform(17, 17), uniform(9, 9), em.Expression("tanh(6*(x + y/2 - 0.75))")
    thin, values = em.Mesh.of_unit_square(first.x**3, first.y), u.evaluate(mesh.x, mesh.y)[0]
    known = ErrorEstimate.of(mesh, values, UNIT_SQUARE)
    nodal, added = projection(thin, known.recovery.u)
    near, far = EarlierValues(thin, nodal + 0.6 * added), EarlierValues(thin, nodal + 0.4 * added)
    poisson, other = (ErrorEstimate.of(mesh, values, UNIT_SQUARE, earlier=one) for one in (near, far))
    assert are_of_poisson(far, known.recovery.u, 1.0, "quad")
    assert (known.is_for_solver, poisson.is_for_solver, other.is_for_solver) == (True, True, False)
    assert (poisson.estimate, other.estimate) == (known.estimate, other.recovery.estimate("l2", of_solver=False))


def test_fitted_gradients_are_nearer_to_a_smooth_function() -> None:
    u = em.Expression("sin(3*x)*cos(2*y)")
    mesh = uniform(17, 17)
    limited = Recovery.of(mesh, u.evaluate(mesh.x, mesh.y)[0], UNIT_SQUARE)
    x, y = np.random.default_rng(3).random((2, 200))
    errors = [np.abs(one.u.evaluate(x, y)[0] - u.evaluate(x, y)[0]).max() for one in (limited, limited.fitted())]
    assert errors[1] < 0.3 * errors[0]
    known = ErrorEstimate.of(mesh, limited.values, UNIT_SQUARE)
    made = [dataclasses.replace(known, unresolved=left).wanted("l2").u for left in (0.03, 0.05)]
    assert [one.evaluate(x, y)[0].tolist() == limited.u.evaluate(x, y)[0].tolist() for one in made] == [False, True]


def test_the_error_of_a_solver_is_lowered_where_it_is_requested() -> None:
    u = em.Expression("atan(100*(sqrt((x + 0.05)**2 + (y + 0.05)**2) - 0.7))")
    here = search(u, 25, 25)
    first = min(here.candidates(), key=lambda one: one.error)
    of_solver = dataclasses.replace(here, of_solver=True)
    meshes = [mesh_of(one.finished(first).mesh, here.before.grid) for one in (here, of_solver)]
    plain, projected = (of_solver.error_on(mesh) for mesh in meshes)
    assert projected < 0.8 * plain
    assert here.error_on(meshes[0]) < here.error_on(meshes[1])


@pytest.mark.parametrize(("n", "m"), [(4, 4), (9, 9), (12, 30), (17, 65)])
def test_every_grid_has_candidates(n: int, m: int) -> None:
    here = search(STEEP_FRONT, n, m)
    found = list(here.candidates())
    assert len(found) >= 3
    assert len({one.name for one in found}) == len(found)
    assert here.finished(found[0]).mesh.shape == (2, n * m)


def test_a_mesh_that_folds_on_coarse_grids_still_has_candidates_that_begin_with_it() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=65, n_eta=65))
    x, y = uniform.x - 0.5, uniform.y - 0.5
    turn = 2.2 * np.maximum(0.0, 1.0 - (x * x + y * y) / 0.2) ** 2  # a whirl
    whirl = em.Mesh(0.5 + np.cos(turn) * x - np.sin(turn) * y, 0.5 + np.sin(turn) * x + np.cos(turn) * y)
    assert not whirl.is_folded
    assert em.Mesh(whirl.x[::8, ::8], whirl.y[::8, ::8]).is_folded
    names = {one.name for one in Search(u=STEEP_FRONT, domain=UNIT_SQUARE, before=whirl, norm="l2").candidates()}
    assert names & {name for name, *_ in SAMPLED}


def test_candidates_of_a_domain_with_curved_sides_are_not_folded() -> None:
    domain = em.AnnulusSector(radii=(1.0, 2.0))
    ring = em.Expression("tanh(40*(sqrt(x**2 + y**2) - 1.5))")
    here = Search(u=ring, domain=domain, before=em.Mesh.uniform(em.Grid(n_xi=33, n_eta=33)), norm="l2")
    errors = {}
    for one in here.candidates():
        mesh = map_mesh(mesh_of(one.mesh, here.before.grid), domain)
        assert not mesh.is_folded
        errors[one.name] = one.error
    assert errors[STRAIGHT] < 0.9 * max(errors.values())


def test_candidates_that_are_folded_on_the_domain_alone_are_left_out() -> None:
    domain = em.AnnulusSector(radii=(0.5, 1.0), angles=(0.0, 350.0))
    # Straight lines crowd at the last angles; the first cell then spans more than half a turn.
    steep = OnDomain(reference=em.Expression("tanh(200*(y - 0.95))"), domain=domain)
    before = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    lines = rectilinear(steep, domain, before.grid.shape, "l2", LINE_FLOORS[-1])
    assert lines is not None
    straight = em.Mesh(*np.meshgrid(*lines, indexing="ij"))
    assert not straight.is_folded
    assert map_mesh(straight, domain).is_folded
    for one in Search(u=steep, domain=domain, before=before, norm="l2").candidates():
        assert not map_mesh(mesh_of(one.mesh, before.grid), domain).is_folded


SQUARE = em.Mesh.uniform(em.Grid(17))


def layer(power: float) -> em.Expression:
    return em.Expression(f"exp(-30*x) + {power}*exp(-30*y)")


@pytest.mark.parametrize(("u", "low", "high"), [("exp(-30*x)", 10.0, 20.0), ("exp(-30*y)", 1 / 20.0, 1 / 10.0)])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_one_direction_gets_nearly_all_lines_of_a_function_of_it(u: str, low: float, high: float, norm: str) -> None:
    along, across = best_counts(em.Expression(u), UNIT_SQUARE, 400, norm, SQUARE)
    assert low < along / across < high
    assert 300 < (along + 1) * (across + 1) <= 400


def test_equal_directions_keep_the_grid() -> None:
    assert best_counts(layer(1.0), UNIT_SQUARE, 289, "l2", SQUARE).tolist() == [16, 16]


@pytest.mark.parametrize("points", [25, 289, 4000])
@pytest.mark.parametrize("ratio", [1e-6, 0.3, 1.0, 50.0, 1e6])
def test_a_grid_has_at_most_its_points(points: int, ratio: float) -> None:
    along, across = GRID.within(points, np.array([ratio, 1.0]), least_counts(GRID))
    assert 0.8 * points < (along + 1) * (across + 1) <= points
    assert min(along, across) >= 4


@pytest.mark.parametrize("points", [24, 0, -5, 100.5, True, "100", None])
def test_a_budget_without_a_grid_is_refused(points: object) -> None:
    with pytest.raises(em.InputError, match="at least 25 points") as refused:
        require_budget(points)
    assert refused.value.field == "points"


def test_more_points_than_a_mesh_has_are_refused() -> None:
    most, blocks = 10**12, em.Blocks.rectangle(cells=(2, 2))
    for domain in (UNIT_SQUARE, blocks):
        with pytest.raises(em.InputError, match=f"^{most} points are too many") as refused:
            em.adapt(lambda mesh: mesh.points[:, 0], domain=domain, points=most)
        assert refused.value.field == "points"
    with pytest.raises(em.InputError, match="the coarsest mesh of these blocks has 9 points"):
        em.solve_to(em.Target(max_points=8), monitor=em.LeastError(u=em.Expression("x")), domain=blocks)


@pytest.mark.parametrize(
    ("call", "name", "hint"),
    [
        (em.Grid, "points", r"give Target\(max_points"),
        (em.Problem, "points", r"give Target\(max_points"),
        (em.Target, "points", "did you mean 'max_points'"),
        (em.adapt, "max_points", "did you mean 'points'"),
    ],
)
def test_another_name_of_a_budget_is_refused_with_a_hint(call: Any, name: str, hint: str) -> None:
    with pytest.raises(TypeError, match=rf"{call.__name__}\(\) has no argument '{name}'; .*{hint}"):
        call(**{name: 400})


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_error_at_fixed_points_is_that_of_the_interpolant(norm: str) -> None:
    domain, u = em.Rectangle(x=(0.0, 2.0), y=(-1.0, 2.0)), em.Expression("sin(3*x + 2*y)")
    fine = em.Mesh.uniform(em.Grid(65))
    mesh = em.Mesh.uniform(em.Grid(17, 9))
    x, y = domain.map(mesh.x, mesh.y)
    measured = FixedPoints.of(u, domain, fine).error(mesh, u.evaluate(x, y)[0], norm)
    errors = measure_errors(em.Mesh(x, y), u, alone=True)
    assert measured == pytest.approx({"l2": errors.l2, "h1": errors.h1}[norm], rel=0.01)


def test_a_peak_inside_a_cell_is_an_error() -> None:
    peak = em.Expression("exp(-1000*((x - 0.52)**2 + (y - 0.52)**2))")
    seeing, blind = em.Mesh.uniform(em.Grid(129)), em.Mesh.uniform(em.Grid(5))
    fixed = FixedPoints.of(peak, UNIT_SQUARE, seeing)
    size = fixed.error(blind, np.zeros((5, 5)), "l2")
    assert size == pytest.approx(np.sqrt(np.pi / 2000.0), rel=1e-3)


def test_a_mesh_goes_to_another_grid() -> None:
    mesh = em.Mesh(*np.meshgrid(np.linspace(0, 1, 9) ** 2, np.linspace(0, 1, 9), indexing="ij"))
    found = on_grid(mesh, em.Grid(17, 5))
    assert found.grid == em.Grid(17, 5)
    assert found.x[:, 2] == pytest.approx(np.linspace(0, 1, 17) ** 2, abs=1e-3)
    assert on_grid(mesh, mesh.grid) is mesh


def test_a_loop_searches_once_the_solution_is_resolved_and_until_a_shape_is_kept() -> None:
    search = ShapeSearch(points=289, domain=UNIT_SQUARE)
    mesh = em.Mesh.uniform(with_counts(UNIT_SQUARE, counts_within(289, UNIT_SQUARE)))
    thin, even = (ErrorEstimate.of(mesh, f.evaluate(mesh.x, mesh.y)[0], UNIT_SQUARE) for f in THIN_AND_EVEN)
    assert search.next(thin, "l2", 1) == mesh.grid
    assert not search.is_settled
    assert search.next(even, "l2", 1) == mesh.grid
    assert search.is_settled


THIN_AND_EVEN = em.Expression("exp(-500*x)"), em.Expression("sin(3*x)*sin(3*y)")


def test_values_at_a_seam_may_differ_as_a_solver_left_them() -> None:
    mesh, domain = em.Mesh.uniform(em.Grid(9)), em.Rectangle(periodic="x")
    values = np.sin(2.0 * np.pi * mesh.x) * mesh.y
    exact = em.adapt_round(mesh, values, domain).estimate
    values[-1] += 1e-5
    assert em.adapt_round(mesh, values, domain).estimate == pytest.approx(exact, rel=1e-3)
