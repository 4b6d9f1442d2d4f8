"""The objective: its terms, its derivatives on every domain, its units, and the threads that share the work."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.least_error import objective as module
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import Weights
from equimesh.least_error.starts import mesh_of
from equimesh.quality.cells import BilinearCells, ChosenCells
from equimesh.quality.degrees import squared_errors
from equimesh.quality.elements import basis
from equimesh.quality.tally import ErrorRule, ErrorTally
from solver.bent import CURVED, DOMAINS, RING, SECTOR, WEIGHTS, bent, objective_on, remainders, uniform
from solver.quality.handmade import triangle_errors

GRID = em.Grid(n_xi=7, n_eta=6)
NORMS: tuple[Norm, ...] = ("l2", "h1")
RULES = {"quad l2": Rule(), "quad h1": Rule(norm="h1"), "tri l2": Rule(cells="triangle")}
OF_DEGREE: dict[str, Rule] = {
    **{f"quad {n} {degree}": Rule(norm=n, degree=degree, points=degree + 2) for n in NORMS for degree in (1, 2, 3, 4)},
    **{f"triangle {n}": Rule(norm=n, degree=2, cells="triangle") for n in NORMS},
}


@pytest.mark.parametrize(
    ("domain", "rule"), [*itertools.product(DOMAINS, RULES), *(("curved", rule) for rule in OF_DEGREE)]
)
def test_the_taylor_remainder_falls_at_second_order(domain: str, rule: str) -> None:
    mesh = bent(GRID, 1)
    objective = objective_on(GRID, domain=DOMAINS[domain], start=bent(GRID, 2), rule=(RULES | OF_DEGREE)[rule])
    objective.cut(mesh)
    here = objective.evaluate(mesh)
    direction = np.random.default_rng(3).normal(size=mesh.shape) * cells_of_grid(GRID.shape).free

    def value(h: float) -> float:
        then = objective.evaluate(mesh + h * direction)
        return then.value

    first, second = remainders(value, float(np.vdot(here.gradient, direction)), 2e-4)
    assert first > 1e-9  # not rounding
    assert first / second == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("domain", DOMAINS)
def test_the_error_is_that_of_an_independent_quadrature(domain: str, norm: str) -> None:
    mesh = bent(GRID, 4)
    objective = objective_on(GRID, domain=DOMAINS[domain], rule=Rule(norm=norm, points=3))  # type: ignore[arg-type]
    cells = BilinearCells(map_mesh(mesh_of(mesh, GRID), DOMAINS[domain]))
    tally = ErrorTally.of(cells, RING, ErrorRule.gauss(3))
    tally.add_all()
    l2, h1 = np.sqrt(tally.sums[:2].sum(axis=1))
    assert objective.error(mesh) == pytest.approx(l2 if norm == "l2" else h1, rel=1e-12)


@pytest.mark.parametrize("rule", OF_DEGREE)
@pytest.mark.parametrize("domain", DOMAINS)
def test_the_error_of_a_degree_is_that_of_the_certificate_by_the_same_rule(domain: str, rule: str) -> None:
    mesh, of_degree = bent(GRID, 4), OF_DEGREE[rule]
    objective = objective_on(GRID, domain=DOMAINS[domain], rule=of_degree)
    objective.cut(mesh)
    cells, kind = BilinearCells(map_mesh(mesh_of(mesh, GRID), DOMAINS[domain])), of_degree.cells
    chosen, element = ChosenCells.of(cells.rows), of_degree.element
    bases = [basis(kind, of_degree.degree, element)]
    found = squared_errors((cells,), chosen, RING, bases, element, kind)[0, 0, NORMS.index(of_degree.norm)]
    assert objective.error(mesh) == pytest.approx(math.sqrt(found.sum()), rel=1e-11)


@pytest.mark.parametrize("seed", range(3))
def test_triangles_are_those_that_the_certificate_measures(seed: int) -> None:
    # Both rules are exact for the squared error of a quadratic u; cells at the corners are cut through the corner.
    mesh, quadratic = bent(GRID, seed), em.Expression("3*x**2 - x*y + 2*y**2")
    objective = objective_on(GRID, quadratic, rule=RULES["tri l2"])
    objective.cut(mesh)
    assert objective.error(mesh) == pytest.approx(triangle_errors(mesh_of(mesh, GRID), quadratic).l2, rel=1e-12)


@pytest.mark.parametrize("domain", DOMAINS)
def test_at_the_start_only_the_error_counts(domain: str) -> None:
    start = bent(GRID, 5)
    objective = objective_on(GRID, domain=DOMAINS[domain], start=start)
    here = objective.evaluate(start)
    assert here.value == pytest.approx(math.log(objective.error(start)), rel=1e-12)
    assert here.error == pytest.approx(objective.error(start), rel=1e-14)
    assert here.distortion == pytest.approx(0.0, abs=1e-12)
    assert objective.smallest_share(start) == pytest.approx(1.0, rel=1e-14)


def test_no_mesh_with_a_lower_objective_has_a_larger_error() -> None:
    objective, start = objective_on(GRID), uniform(GRID)
    first = objective.evaluate(start)
    assert first is not None
    lower = 0
    for seed in range(40):
        then = objective.evaluate(bent(GRID, seed, share=0.1))
        assert then.value > math.log(then.error)
        if then.value <= first.value:
            lower += 1
            assert then.error <= first.error
    assert lower > 0  # the promise was put to the test


def test_the_terms_have_their_weights() -> None:
    mesh = bent(GRID, 6)
    parts = [
        objective_on(GRID, weights=Weights(distortion=a, smoothness=b)).evaluate(mesh)
        for a, b in ((1e-9, 0.0), (1.0, 0.0), (0.0, 1.0))
    ]
    none, distorted, bending = (part for part in parts if part is not None)
    assert distorted.value - none.value == pytest.approx(distorted.distortion, rel=1e-6)
    moves = (mesh - uniform(GRID)).reshape(2, *GRID.shape)
    bends = 0.5 * sum((np.diff(moves, 2, axis=axis) ** 2).sum() for axis in (1, 2))
    assert bending.value - none.value == pytest.approx(bends, rel=1e-6)


@pytest.mark.parametrize("factor", [1e-150, 1e-8, 1e8, 1e120])
def test_units_of_u_do_not_change_its_derivatives(factor: float) -> None:
    mesh = bent(GRID, 7)
    scaled = em.Expression(f"{factor!r}*({RING.text})")
    here, there = objective_on(GRID).evaluate(mesh), objective_on(GRID, scaled).evaluate(mesh)
    assert there.value - here.value == pytest.approx(math.log(factor), rel=1e-12)
    assert there.gradient == pytest.approx(here.gradient, rel=1e-9, abs=1e-9)
    assert there.blocks == pytest.approx(here.blocks, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("domain", DOMAINS)
def test_blocks_are_positive_definite_and_apart_on_sides(domain: str) -> None:
    here = objective_on(GRID, domain=DOMAINS[domain]).evaluate(bent(GRID, 8, share=0.4))
    a, b, d = here.blocks
    assert (a > 0).all()
    assert (a * d > b * b).all()
    free = cells_of_grid(GRID.shape).free
    assert (b[free.min(axis=0) == 0] == 0).all()
    assert (here.gradient[free == 0] == 0).all()


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_threads_do_not_change_a_bit(norm: str) -> None:
    grid = em.Grid(n_xi=120, n_eta=110)
    rule = Rule(norm=norm)  # type: ignore[arg-type]
    mesh = bent(grid, 9)
    one, *others = (objective_on(grid, rule=rule, domain=SECTOR, threads=k).evaluate(mesh) for k in (1, 2, 3))
    assert one is not None
    for other in others:
        assert other.value == one.value
        assert np.array_equal(other.gradient, one.gradient)
        assert np.array_equal(other.blocks, one.blocks)


@pytest.mark.parametrize("rule", RULES)
def test_blocks_of_points_only_change_rounding(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = bent(GRID, 10)
    whole = objective_on(GRID, rule=RULES[rule]).evaluate(mesh)
    monkeypatch.setattr(module, "MAX_BLOCK_POINTS", 30)
    parts = objective_on(GRID, rule=RULES[rule]).evaluate(mesh)
    assert parts.value == pytest.approx(whole.value, rel=1e-14)
    assert parts.gradient == pytest.approx(whole.gradient, rel=1e-11, abs=1e-13)


def test_there_is_no_value_where_cells_are_folded_or_the_error_is_zero_or_not_finite() -> None:
    folded = uniform(GRID)
    folded[:, GRID.n_eta + 1] = 0.9
    assert objective_on(GRID).evaluate(folded) is None
    assert objective_on(GRID).smallest_share(folded) < 0.0
    nearly = bent(GRID, 11)
    smallest = objective_on(GRID).smallest_share(nearly)
    assert objective_on(GRID).evaluate(nearly, 0.99 * smallest) is not None
    assert objective_on(GRID).evaluate(nearly, smallest) is None
    assert objective_on(GRID, em.Expression("0*x")).evaluate(uniform(GRID)) is None
    pole = objective_on(GRID, em.Expression("1/(x - 0.4)"))
    mesh = bent(GRID, 11)
    mesh[0, 2 * GRID.n_eta + 2] = 0.4
    assert pole.evaluate(mesh) is None
    assert pole.error(mesh) == math.inf


def test_triangles_are_cut_anew_on_request() -> None:
    mesh, u = bent(GRID, 12, share=0.45), em.Expression("x*y + x**2")
    objective = objective_on(GRID, u, CURVED, rule=Rule(cells="triangle"), weights=WEIGHTS)
    first = objective.error(mesh)
    assert objective.cut(mesh)
    assert not objective.cut(mesh)
    assert abs(objective.error(mesh) / first - 1.0) > 1e-3
    assert not objective_on(GRID, u, CURVED).cut(mesh)


@pytest.mark.parametrize("points", [30, 10_000])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_infinite_slopes_at_nodes_of_sides_do_no_harm(norm: str, points: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_BLOCK_POINTS", points)
    u, mesh = em.Expression("sqrt(x) + (x**2 + y**2)**(1/3)"), bent(GRID, 14)
    with np.errstate(all="ignore"):
        objective = objective_on(GRID, u, rule=Rule(norm=norm))  # type: ignore[arg-type]
        here = objective.evaluate(mesh)
        assert np.isfinite(here.gradient).all()
        assert np.isfinite(here.blocks).all()
        direction = np.random.default_rng(4).normal(size=mesh.shape) * cells_of_grid(GRID.shape).free

        def value(h: float) -> float:
            then = objective.evaluate(mesh + h * direction)
            return then.value

        first, second = remainders(value, float(np.vdot(here.gradient, direction)), 1e-4)
    assert first / second == pytest.approx(4.0, abs=0.4)


def test_corners_beyond_the_limit_have_weight_and_others_none() -> None:
    mesh = bent(GRID, 15, share=0.3)
    plain, without, limited = (
        objective_on(GRID, weights=Weights(distortion=0.03, smoothness=0.1, **more))
        for more in ({}, {"obliqueness": 7.0}, {"obliqueness": 7.0, "largest_cotangent": 0.3})
    )
    values = [objective.evaluate(mesh) for objective in (plain, without, limited)]
    first, second, third = (value for value in values if value is not None)
    assert first.value == second.value
    assert np.array_equal(first.gradient, second.gradient)
    corners = mesh_of(mesh, GRID).points[cells_of_grid(GRID.shape).corners]
    a, b = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cotangents = (a * b).sum(axis=-1) / (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    expected = 7.0 * (0.5 * np.maximum(np.abs(cotangents) - 0.3, 0.0) ** 2).mean()
    assert expected > 0.0
    assert third.value - first.value == pytest.approx(expected, rel=1e-9)
    direction = np.random.default_rng(16).normal(size=mesh.shape) * cells_of_grid(GRID.shape).free

    def value(h: float) -> float:
        then = limited.evaluate(mesh + h * direction)
        return then.value

    one, half = remainders(value, float(np.vdot(third.gradient, direction)), 2e-4)
    assert one / half == pytest.approx(4.0, abs=0.4)
