"""Solve, adapt, solve: with solvers that are cheap, and with what they can do wrong."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import equimesh as em
from equimesh.adaptation.loop import Rounds, averaged_mesh, indicated_mesh, record_of
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.errors import InputError
from equimesh.quality.cells import BilinearCells
from equimesh.quality.faces import measure_faces
from equimesh.quality.measures import measure_errors
from equimesh.rounds.estimate import ErrorEstimate
from equimesh.testing import GEOMETRIES
from equimesh.testing.geometries import l_shape

FRONT = em.Expression("tanh(30*(x + y/2 - 0.75))")
SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


def sampled(u: em.Expression = FRONT) -> Callable[[em.Mesh], np.ndarray]:
    """A solver that is exact at the nodes."""
    return lambda mesh: u.evaluate(mesh.x, mesh.y)[0]


@cache
def on_the_front() -> em.Adaptation:
    """What several tests look at."""
    return em.adapt(sampled(), 33)


def gain(found: em.Adaptation, u: em.Expression = FRONT) -> float:
    first, best = (measure_errors(mesh, u).l2 for mesh in (found.rounds[0].mesh, found.mesh))
    return first / best


@pytest.mark.parametrize(
    ("u", "domain", "least"), [(FRONT, UNIT_SQUARE, 11.0), (em.Expression("tanh(30*(x + y/2 - 1.6))"), SECTOR, 4.0)]
)
def test_rounds_lower_the_error_of_a_front(u: em.Expression, domain: em.Domain, least: float) -> None:
    found = on_the_front() if u is FRONT else em.adapt(sampled(u), (17, 25), domain=domain, rounds=3)
    assert gain(found, u) > least
    assert found.resolved
    assert found.mesh.min_jacobian > 0
    assert 2 <= len(found.rounds) - 1 <= 5
    assert found.estimate == min(one.estimate for one in found.rounds)
    assert [one.number for one in found.rounds] == [*range(len(found.rounds))]
    assert (found.rounds[0].start, found.rounds[0].moved_cells) == ("given", 0.0)
    assert found.rounds[1].moved_cells > 0.5


def test_the_norm_of_the_gradient_is_lowered_where_it_is_requested() -> None:
    errors = []
    for found in (on_the_front(), em.adapt(sampled(), 33, norm="h1")):
        errors.append(measure_errors(found.mesh, FRONT))
        assert errors[-1].h1_uniform > 4 * errors[-1].h1
    assert errors[1].h1 < 0.95 * errors[0].h1


def test_the_best_round_is_that_of_the_requested_norm() -> None:
    # The mesh of the first round has the smaller error of u, and twice the error of the gradient.
    layers = em.Expression("(1 - exp((x - 1)/0.01))*(1 - exp((y - 1)/0.01))*cos(pi*(x + y))")
    found = em.adapt(sampled(layers), 33, norm="h1")
    errors = [measure_errors(one.mesh, layers).h1 for one in found.rounds]
    least_l2 = min(found.rounds, key=lambda one: one.estimate)
    assert found.best == min(found.rounds, key=lambda one: one.unresolved or 0.0).number
    assert errors[found.best] < 0.75 * errors[least_l2.number]


def test_boundary_layers_are_resolved_by_straight_lines() -> None:
    u = em.Expression("(x - exp((x - 1)/0.005))*(y - exp((y - 1)/0.005))")
    found = em.adapt(sampled(u), 33)
    assert gain(found, u) > 100
    assert found.resolved
    assert {one.start for one in found.rounds[1:]} & {"lines", "straight lines"}


def test_a_layer_that_no_mesh_meets_is_not_resolved() -> None:
    found = em.adapt(sampled(em.Expression("tanh(1e7*(x*x + y*y/2 - 0.55))")), 17, rounds=2)
    assert not found.resolved
    assert 0.15 < found.rounds[found.best].unresolved < 0.6


def test_a_smooth_solution_ends_early_and_a_linear_one_at_once() -> None:
    smooth = em.adapt(sampled(em.Expression("sin(x)*cos(y)")), 9, rounds=20)
    assert smooth.reason == "The estimate stands still: it did not fall by 15% in the last 2 rounds."
    assert len(smooth.rounds) < 8
    linear = em.adapt(lambda mesh: 2.0 * mesh.x - mesh.y, 9)
    assert len(linear.rounds) == 1
    assert (linear.estimate, linear.resolved) == (0.0, True)


def test_the_grid_may_be_a_number_or_a_pair_of_any_whole_numbers() -> None:
    for n in (9, np.int64(9), [9, 9], (np.int32(9), 9)):
        assert em.adapt(lambda mesh: mesh.x, n).mesh.x.shape == (9, 9)


def test_every_round_is_observed_and_an_observer_can_end_the_loop() -> None:
    seen: list[int] = []

    def observe(record: em.AdaptRound) -> None:
        seen.append(record.number)
        if record.number == 1:
            raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        em.adapt(sampled(), 9, observe=observe)
    assert seen == [0, 1]


def test_an_error_indicator_adapts_by_a_weight_and_its_sum_decides() -> None:
    def means(nodal: np.ndarray) -> np.ndarray:
        return 0.25 * (nodal[1:, 1:] + nodal[1:, :-1] + nodal[:-1, 1:] + nodal[:-1, :-1])

    def solve(mesh: em.Mesh) -> em.ErrorIndicator:
        u, middle = FRONT.evaluate(mesh.x, mesh.y)[0], FRONT.evaluate(means(mesh.x), means(mesh.y))[0]
        return em.ErrorIndicator(np.abs(means(u) - middle))

    found = em.adapt(solve, 17)
    assert gain(found) > 2
    assert found.values.shape == (16, 16)
    assert found.estimate == pytest.approx(np.linalg.norm(found.values))
    assert found.estimate == min(one.estimate for one in found.rounds)
    assert (found.rounds[1].start, found.rounds[1].estimate_h1) == ("weight", None)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (lambda mesh: np.full(mesh.x.size, np.nan), "the solver diverged"),
        (lambda mesh: np.zeros(len(mesh.cells)), "wrap averages over cells in CellAverages"),
        (lambda _: np.zeros(7), "needs one value for each of the 81 nodes"),
        (lambda _: None, "is None"),
        (lambda mesh: em.ErrorIndicator(-np.ones(len(mesh.cells))), "negative"),
    ],
)
def test_bad_values_are_refused_at_first_and_end_the_loop_later(
    wrong: Callable[[em.Mesh], object], sentence: str
) -> None:
    with pytest.raises(em.BadValues, match=sentence):
        em.adapt(wrong, 9)
    calls: list[em.Mesh] = []

    def at_first_right(mesh: em.Mesh) -> object:
        calls.append(mesh)
        return sampled()(mesh) if len(calls) < 3 else wrong(mesh)

    found = em.adapt(at_first_right, 9)
    assert len(found.rounds) == 2
    assert any(np.array_equal(found.mesh.x, mesh.x) for mesh in calls[:2])
    assert isinstance(found.failure, em.BadValues)
    assert found.reason.startswith("Round 2 failed, and the best mesh before it is kept: BadValues: ")
    assert sentence in found.reason


def test_an_exception_of_the_solver_is_its_own_at_first_and_ends_the_loop_later() -> None:
    calls: list[em.Mesh] = []

    def singular(mesh: em.Mesh) -> np.ndarray:
        calls.append(mesh)
        if len(calls) == 2:
            raise ZeroDivisionError("the matrix is singular")
        return sampled()(mesh)

    found = em.adapt(singular, 9)
    assert len(found.rounds) == 1
    assert isinstance(found.failure, ZeroDivisionError)
    assert "ZeroDivisionError: the matrix is singular" in found.reason
    calls.append(em.Mesh.uniform(em.Grid(n_xi=4, n_eta=4)))
    calls[:] = calls[:1]
    with pytest.raises(ZeroDivisionError):
        em.adapt(singular, 9)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"n": 2}, "grid"),
        ({"n": "65"}, "n"),
        ({"n": (9, 9, 9)}, "n"),
        ({"n": (9, 9.5)}, "n"),
        ({"n": True}, "n"),
        ({"rounds": 0}, "rounds"),
        ({"rounds": True}, "rounds"),
        ({"norm": "linf"}, "norm"),
        ({"solve": 3}, "solve"),
        ({"threads": 0}, "threads"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, object], field: str) -> None:
    given = {"solve": sampled(), "n": 9, **arguments}
    with pytest.raises(InputError) as caught:
        em.adapt(given.pop("solve"), given.pop("n"), **given)
    assert caught.value.field.startswith(field)


def test_a_solver_may_change_the_arrays_of_its_mesh_and_use_its_own_again() -> None:
    own = np.zeros((9, 9))

    def solve(mesh: em.Mesh) -> np.ndarray:
        own[:] = np.tanh(8.0 * (mesh.x - 0.5)) + mesh.y**2
        mesh.x[:] *= 2.0
        return own

    found = em.adapt(solve, 9)
    assert found.mesh.x.max() == 1.0
    assert np.array_equal(found.values, np.tanh(8.0 * (found.mesh.x - 0.5)) + found.mesh.y**2)


def test_solutions_and_indicators_are_not_mixed() -> None:
    found = em.adapt(lambda mesh: np.tanh(9 * mesh.x) if mesh.x[1, 1] == 0.125 else em.ErrorIndicator(np.ones(64)), 9)
    assert "this solve returned an error indicator, and those before it a solution" in found.reason


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"domain": "annulus"}, "domain = 'annulus' is no domain"),
        ({"domain": {"kind": 1}}, "domain = {'kind': 1} is no domain"),
        ({"observe": 5}, "no function"),
        ({"solve": 9, "n": abs}, "solve = 9 is no function: give one that takes a mesh"),
        ({"solve": lambda: 1}, r"solve cannot be called as solve\(mesh\): too many"),
        ({"solve": lambda x, y: x * y}, "argument: 'y'; give a function of the mesh alone"),
    ],
)
def test_other_arguments_that_cannot_be_used(changed: dict, words: str) -> None:
    with pytest.raises(em.InputError, match=words):
        em.adapt(**{"solve": lambda mesh: mesh.x, "n": 9, **changed})


# The next mesh of blocks from averages over the cells: better, and of cells that suit finite volumes.


def test_cells_stay_even_where_the_usual_weights_make_them_oblique() -> None:
    domain = GEOMETRIES["step"](400)
    layer = em.Expression("tanh(8*(y - 0.5 - 0.1*x))")
    u = em.QuadField(mesh=domain.mesh, values=layer.evaluate(*domain.mesh.points.T)[0])
    even = averaged_mesh(u, domain, "l2", threads=1)
    usual = em.adapt_round(domain.mesh, u.values, domain)
    assert even.distance(domain.mesh) > 0.0
    assert measure_faces(even).non_orthogonality < 0.7 * measure_faces(usual.mesh).non_orthogonality


def test_the_mesh_of_a_linear_function_is_the_one_before() -> None:
    domain = GEOMETRIES["step"](100)
    flat = em.QuadField(mesh=domain.mesh, values=domain.mesh.points[:, 0].copy())
    assert averaged_mesh(flat, domain, "l2", threads=1).distance(domain.mesh) == 0.0


# The next mesh by an error indicator of the cells.


def uniform(n: int, m: int, domain: em.Domain = UNIT_SQUARE) -> em.Mesh:
    return map_mesh(em.Mesh.uniform(em.Grid(n_xi=n, n_eta=m)), domain)


def middles(mesh: em.Mesh) -> tuple[np.ndarray, np.ndarray]:
    return tuple(0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]) for q in (mesh.x, mesh.y))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, SECTOR])
def test_cells_are_small_where_the_indicator_is_large(domain: em.Domain) -> None:
    mesh = uniform(17, 17, domain)
    x, y = middles(mesh)
    indicator = np.exp(-30.0 * (np.hypot(x, y) - 1.2) ** 2)
    found = indicated_mesh(mesh, indicator, domain, "l2", 1)
    assert found.min_jacobian > 0
    x, y = middles(found)
    area = BilinearCells(found).area.reshape(16, 16)
    near = np.abs(np.hypot(x, y) - 1.2) < 0.05
    far = np.abs(np.hypot(x, y) - 1.2) > 0.4
    assert area[near].mean() < 0.4 * area[far].mean()


def test_an_indicator_of_zero_keeps_the_mesh() -> None:
    mesh = uniform(9, 9)
    assert indicated_mesh(mesh, np.zeros((8, 8)), UNIT_SQUARE, "l2", 1) is mesh


# What a loop does on meshes of grids and of blocks.


DOMAIN = l_shape(300)


def test_meshes_for_a_solver_have_arrays_of_their_own() -> None:
    grid = Rounds(grid=em.Grid(n_xi=5, n_eta=4), domain=em.Rectangle(), norm="l2", threads=1)
    blocks = Rounds(domain=DOMAIN, norm="l2", threads=1)
    first, moved, start = grid.first()
    assert (first.x.shape, moved, start) == ((5, 4), 0.0, "given")
    copy = grid.copied(first)
    copy.x[:] = 9.0
    assert first.x.max() == 1.0
    other = blocks.copied(blocks.first()[0])
    other.points[:] = 9.0
    assert DOMAIN.mesh.points.max() < 9.0


def test_the_record_of_values_on_blocks_has_their_estimates() -> None:
    mesh = DOMAIN.mesh
    values = np.sin(4 * mesh.x)
    record, following = Rounds(domain=DOMAIN, norm="l2", threads=1).known(mesh, values)
    known = ErrorEstimate.of(mesh, values, DOMAIN)
    assert (record.estimate, record.unresolved) == (known.estimate, known.unresolved)
    assert record_of(known, mesh, values).estimate_h1 == record.estimate_h1
    found, moved, start = following()
    assert isinstance(found, em.Mesh)
    assert moved > 0.0
    assert start == "whole"


def test_a_loop_on_blocks_adapts_to_values_and_to_averages() -> None:
    front = em.Expression("tanh(15*(x + y - 1))")

    def nodal(mesh: em.Mesh) -> np.ndarray:
        return front.evaluate(mesh.x, mesh.y)[0]

    def averages(mesh: em.Mesh) -> em.CellAverages:
        return em.CellAverages(front.evaluate(*mesh.points[mesh.cells].mean(axis=1).T)[0])

    for solve in (nodal, averages):
        seen: list[em.AdaptRound[em.Mesh]] = []
        found = em.adapt(solve, domain=DOMAIN, rounds=2, threads=1, observe=seen.append)
        assert [one.number for one in seen] == [0, 1, 2]
        assert found.rounds[0].mesh is DOMAIN.mesh
        assert found.estimate < 0.85 * found.rounds[0].estimate
        assert found.values.shape == DOMAIN.mesh.node_shape
        assert not found.mesh.is_folded


def test_what_cannot_be_used_on_blocks_is_refused() -> None:
    with pytest.raises(em.InputError, match=r"leave n out .*, or give points"):
        em.adapt(lambda mesh: mesh.x, 9, domain=DOMAIN)
    with pytest.raises(em.InputError, match="50 points are too few: the coarsest mesh of these blocks has 65 points"):
        em.adapt(lambda mesh: mesh.x, points=50, domain=DOMAIN)
    with pytest.raises(em.InputError, match=r"n = None: give a number of points a direction, .*; points=4000 finds"):
        em.adapt(lambda mesh: mesh.x)


BUDGET = {"points": DOMAIN.points}


def test_a_loop_finds_the_counts_of_blocks_for_a_number_of_points() -> None:
    layer, domain = em.Expression("exp(-20*x)"), em.Blocks.of_mesh(DOMAIN.mesh.points, DOMAIN.mesh.cells, {})
    even, found = (em.adapt(sampled(layer), domain=domain, rounds=2, threads=1, **of) for of in ({}, BUDGET))
    assert 0.9 * domain.points < len(found.mesh.points) <= domain.points
    assert found.estimate < 0.6 * even.estimate
    counts = domain.with_counts_of(found.mesh).layout
    assert counts.counts.max() > 2 * counts.counts.min()


def test_a_loop_finds_the_shape_of_a_grid_for_a_number_of_points() -> None:
    found = em.adapt(sampled(em.Expression("exp(-20*x)")), points=300, rounds=2)
    square = em.adapt(sampled(em.Expression("exp(-20*x)")), 17, rounds=2)
    assert found.mesh.points.shape[0] <= 300
    assert found.mesh.grid.n_xi > 6 * found.mesh.grid.n_eta
    assert found.estimate < 0.3 * square.estimate


@pytest.mark.parametrize(
    ("arguments", "field"), [({"points": 20}, "points"), ({"n": 9, "points": 100}, "points"), ({}, "n")]
)
def test_a_number_of_points_that_cannot_be_used_is_refused(arguments: dict[str, int], field: str) -> None:
    with pytest.raises(em.InputError) as refused:
        em.adapt(lambda mesh: mesh.x, **arguments)
    assert refused.value.field == field
