"""The map of a weight by the gradient of a potential."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from equimesh import gradient_map
from equimesh.domains.domain import map_mesh
from equimesh.gradient_map import (
    MAX_DEVIATION,
    MAX_MOVES,
    MAX_TABLE_CELLS,
    MIN_DENSITY_SHARE,
    MIN_JACOBIAN,
    MIN_TABLE_CELLS,
    Density,
    MapLevel,
    Placed,
    gradient_map_steps,
)
from equimesh.schwarz.iteration import schwarz_iterations
from equimesh.single_domain.level import Step
from equimesh.specs import build

# The loops of the gradient map: nodes from a potential, areas, densities, averages.


def nodes(phi: np.ndarray, along: float = 1.0, across: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.empty((phi.shape[0] + 1, phi.shape[1] + 1)), np.empty((phi.shape[0] + 1, phi.shape[1] + 1))
    gradient_map.move_nodes(phi, along, across, x, y)
    return x, y


def potential(cells_xi: int, cells_eta: int) -> np.ndarray:
    s = (np.arange(cells_xi)[:, None] + 0.5) / cells_xi
    t = (np.arange(cells_eta) + 0.5) / cells_eta
    result: np.ndarray = 0.02 * np.cos(np.pi * s) * np.cos(2 * np.pi * t)
    return result


def test_nodes_move_by_the_gradient() -> None:
    x, y = nodes(potential(60, 90), along=2.0, across=0.5)
    s, t = np.meshgrid(np.linspace(0, 1, 61), np.linspace(0, 1, 91), indexing="ij")
    by_s = -0.02 * np.pi * np.sin(np.pi * s) * np.cos(2 * np.pi * t)
    by_t = -0.04 * np.pi * np.cos(np.pi * s) * np.sin(2 * np.pi * t)
    assert np.abs(x - s - 2.0 * by_s).max() < 2e-3 * 2.0 * np.abs(by_s).max()
    assert np.abs(y - t - 0.5 * by_t).max() < 2e-3 * 0.5 * np.abs(by_t).max()


def test_nodes_stay_on_their_sides() -> None:
    x, y = nodes(np.random.default_rng(0).normal(size=(7, 5)))
    assert np.array_equal(x[[0, -1]], [[0.0] * 6, [1.0] * 6])
    assert np.array_equal(y[:, [0, -1]].T, [[0.0] * 8, [1.0] * 8])


def test_a_chess_board_moves_no_node() -> None:
    board = (-1.0) ** (np.arange(6)[:, None] + np.arange(8))
    for moved, flat in zip(nodes(board)[:2], nodes(np.zeros((6, 8))), strict=True):
        inner = (slice(1, -1), slice(1, -1))
        assert np.allclose(moved[inner], flat[inner], atol=1e-15)


def test_areas_fill_the_square_and_folds_have_a_negative_jacobian() -> None:
    x, y = nodes(potential(12, 9))
    area = np.empty((12, 9))
    smallest = gradient_map.measure_cells(x, y, area)
    assert area.mean() == pytest.approx(1.0, rel=1e-13)
    assert 0.0 < smallest < area.min()
    x[6, 4] = x[8, 4]
    assert gradient_map.measure_cells(x, y, area) < 0.0
    x[6, 4] = np.nan
    assert np.isnan(gradient_map.measure_cells(x, y, area))


def test_the_smallest_jacobian_is_that_of_any_corner() -> None:
    s, t = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 1, 4), indexing="ij")
    for seed in range(20):
        x, y = (q + 0.1 * np.random.default_rng((seed, k)).normal(size=(4, 4)) for k, q in enumerate((s, t)))
        expected = em.Mesh(x, y).min_jacobian
        assert gradient_map.measure_cells(x, y, np.empty((3, 3))) == pytest.approx(expected, rel=1e-12), seed


def test_densities_are_read_at_the_centres_of_cells() -> None:
    table = np.add.outer(2.0 * np.linspace(0, 1, 9), 3.0 * np.linspace(0, 1, 5))
    x, y = nodes(potential(6, 7))
    out = np.empty((6, 7))
    gradient_map.look_up(table, x, y, out)
    middle = [0.25 * (q[1:, 1:] + q[:-1, 1:] + q[1:, :-1] + q[:-1, :-1]) for q in (x, y)]
    assert np.allclose(out, 2.0 * middle[0] + 3.0 * middle[1], rtol=1e-13)


@pytest.mark.parametrize("mirrored", [False, True])
def test_an_average_keeps_the_integral_and_is_local(mirrored: bool) -> None:
    values = np.random.default_rng(1).random((8, 6))
    weights = np.ones((8, 6))
    if mirrored:  # values at nodes: those on the sides count half
        weights[[0, -1]] *= 0.5
        weights[:, [0, -1]] *= 0.5
    before = float((weights * values).sum())
    spike = np.zeros((8, 6))
    spike[4, 3] = 1.0
    for field in (values, spike):
        gradient_map.average(field, np.empty((8, 6)), mirrored)
    assert float((weights * values).sum()) == pytest.approx(before, rel=1e-13)
    assert spike[3:6, 2:5].tolist() == [[1 / 16, 1 / 8, 1 / 16], [1 / 8, 1 / 4, 1 / 8], [1 / 16, 1 / 8, 1 / 16]]


def test_the_inner_product() -> None:
    one, other = np.random.default_rng(2).random((2, 5, 4))
    assert gradient_map.product(one, other) == pytest.approx(float((one * other).sum()), rel=1e-14)


# Densities on the reference square: the area of the domain's map is in them, and coarse tables miss no detail.


GRID = em.Grid(n_xi=17, n_eta=33)


def of(rho: str, domain: em.Domain, grid: em.Grid = GRID) -> Density:
    return Density.of(em.Weight(rho=em.Expression(rho)).on(domain), domain, grid)


def test_the_density_is_that_of_the_physical_domain() -> None:
    density = of("1 + x**2 + y**2", em.AnnulusSector())
    radius = 1.0 + np.linspace(0, 1, MIN_TABLE_CELLS + 1)
    expected = (1.0 + radius**2) * radius  # the Jacobian of polar coordinates
    assert np.allclose(density.table, (expected / expected.max())[:, None], rtol=1e-12)
    assert density.extents == pytest.approx((1.0, 1.5 * np.pi / 2), rel=1e-6)


def test_tables_grow_with_the_grid_within_limits() -> None:
    assert of("1", em.Rectangle(), em.Grid(n_xi=300, n_eta=9)).table.shape == (513, MIN_TABLE_CELLS + 1)
    assert of("1", em.Rectangle(), em.Grid(n_xi=9, n_eta=1500)).table.shape[1] == MAX_TABLE_CELLS + 1


def test_a_thin_density_is_seen_by_a_coarse_grid() -> None:
    thin = of("1 + 1000*exp(-(200*(x - 0.53))**2)", em.Rectangle())
    coarse = thin.on(em.Grid(n_xi=9, n_eta=9))
    mean = coarse[1:-1].sum(axis=0)[4] + 0.5 * (coarse[0, 4] + coarse[-1, 4])
    assert mean / (coarse.shape[0] - 1) == pytest.approx(float(thin.table[:-1, 4].mean()), rel=0.01)
    assert coarse.max() < 0.2  # spread over the cells of the grid
    assert coarse.shape == (9, 9)


def test_a_constant_density_stays_one() -> None:
    assert np.allclose(of("3", em.Rectangle(x=(0, 5))).on(em.Grid(n_xi=5, n_eta=40)), 1.0, rtol=1e-13)


def test_tiny_densities_count_as_a_share() -> None:
    density = of("exp(-100*x)", em.Rectangle())
    assert density.is_finite
    assert density.table.min() == MIN_DENSITY_SHARE


def test_a_density_that_is_not_finite_is_noticed() -> None:
    class Broken(em.Expression):
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            return tuple(np.where(x > 0.5, np.nan, part) for part in super().evaluate(x, y, order))

    square = em.Rectangle()
    assert not Density.of(em.Weight(rho=Broken("1")), square, GRID).is_finite


# The iteration on one grid: it ends with equal shares, and never accepts a folded mesh.


def level(rho: str, n_xi: int = 17, n_eta: int = 17, domain: em.Domain | None = None) -> MapLevel:
    domain, grid = domain or em.Rectangle(), em.Grid(n_xi=n_xi, n_eta=n_eta)
    density = Density.of(em.Weight(rho=em.Expression(rho)).on(domain), domain, grid)
    return MapLevel(grid=grid, table=density.on(grid), extents=density.extents)


def solved(of: MapLevel) -> list[Placed]:
    return list(of.steps(np.zeros(tuple(n - 1 for n in of.grid.shape))))


@pytest.mark.parametrize("rho", ["1 + 20*exp(-50*((x - 0.4)**2 + (y - 0.6)**2))", "where(x + y < 0.9, 1, 100)"])
def test_shares_become_equal(rho: str) -> None:
    steps = solved(level(rho))
    deviations = [step.deviation for step in steps]
    assert deviations[0] > 10 * MAX_DEVIATION
    assert all(after < before for before, after in pairwise(deviations))
    assert deviations[-1] <= MAX_DEVIATION
    assert len(steps) < 30


def test_a_density_of_one_coordinate_gives_its_equidistribution() -> None:
    last = solved(level("1/(0.1 + x)", 33, 9))[-1]
    exact = 0.1 * 11.0 ** np.linspace(0, 1, 33) - 0.1
    assert np.abs(last.x - exact[:, None]).max() < 0.01
    assert np.abs(last.y - np.linspace(0, 1, 9)).max() < 1e-12


def test_the_map_is_a_gradient() -> None:
    """Its curl vanishes: the change of x along eta is the change of y along xi, on a square of equal spacings."""
    last = solved(level("1 + 20*exp(-50*((x - 0.4)**2 + (y - 0.6)**2))", 33, 33))[-1]
    dx, dy = last.x - np.linspace(0, 1, 33)[:, None], last.y - np.linspace(0, 1, 33)
    by_eta = dx[1:-1, 2:] - dx[1:-1, :-2]
    by_xi = dy[2:, 1:-1] - dy[:-2, 1:-1]
    assert np.abs(by_eta - by_xi).max() < 0.05 * np.abs(by_eta).max()


def test_a_long_rectangle_is_moved_by_a_gradient_in_its_own_lengths() -> None:
    rho = "1 + 5*exp(-3*((x - 2)**2 + (y - 0.5)**2))"
    turned = "1 + 5*exp(-3*((y - 2)**2 + (x - 0.5)**2))"
    wide = solved(level(rho, 33, 9, em.Rectangle(x=(0, 4))))[-1]
    tall = solved(level(turned, 9, 33, em.Rectangle(y=(0, 4))))[-1]
    assert np.allclose(wide.x, tall.y.T, atol=1e-10)
    dx, dy = 4.0 * (wide.x - np.linspace(0, 1, 33)[:, None]), wide.y - np.linspace(0, 1, 9)
    by_y, by_x = dx[1:-1, 2:] - dx[1:-1, :-2], dy[2:, 1:-1] - dy[:-2, 1:-1]  # both over a quarter
    assert np.abs(by_y - by_x).max() < 0.25 * np.abs(by_y).max()


def test_no_accepted_mesh_is_folded_even_where_shares_do_not_become_equal() -> None:
    hard = level("1 + 1e9*exp(-(300*(x - y))**2)", 33, 33)
    steps = solved(hard)
    assert all(not em.Mesh(step.x, step.y).is_folded for step in steps)
    assert steps[-1].deviation > MAX_DEVIATION


def test_a_potential_that_folds_is_reduced() -> None:
    here = level("1")
    phi = np.cos(np.pi * (np.arange(16)[:, None] + 0.5) / 16) * np.ones(16)
    assert here.place(phi) is None
    started = here.start(phi)
    assert 0.0 < np.abs(started.phi).max() < np.abs(phi).max()
    mesh = em.Mesh(started.x, started.y)
    assert mesh.min_jacobian > MIN_JACOBIAN
    assert len(list(here.steps(phi))) < MAX_MOVES


# Gradient maps of weights, from the coarse grid to the requested one.


HARD = {
    "peak": "1 + 1000*exp(-200*((x - 0.5)**2 + (y - 0.5)**2))",
    "thin peak": "1 + 1e4*exp(-2000*((x - 0.4)**2 + (y - 0.6)**2))",
    "ring": "1 + 1000*exp(-1000*(hypot(x - 0.5, y - 0.5) - 0.3)**2)",
    "jump": "where((x - 0.5)**2 + (y - 0.5)**2 < 0.04, 1e4, 1)",
    "corner": "1/(1e-4 + x**2 + y**2)",
    "growth": "exp(20*x*y)",
    "line": "1 + 1e4*exp(-(100*(x - y))**2)",
}


def problem(rho: str, n_xi: int = 33, n_eta: int | None = None, domain: em.Domain | None = None) -> em.Problem:
    grid, weight = em.Grid(n_xi=n_xi, n_eta=n_eta or n_xi), em.Weight(rho=em.Expression(rho), map="gradient")
    return em.Problem(monitor=weight, grid=grid, domain=domain or em.Rectangle())


def last(of: em.Problem) -> Step:
    *_, step = gradient_map_steps(of)
    return step


@pytest.mark.parametrize("name", HARD)
def test_steep_weights_are_solved_without_relaxation(name: str) -> None:
    step = last(problem(HARD[name]))
    assert step.converged
    assert step.is_exact
    assert step.residual <= MAX_DEVIATION
    assert not step.mesh.is_folded


def test_a_constant_weight_gives_the_uniform_mesh() -> None:
    mesh = last(problem("7", 12, 20)).mesh
    uniform = em.Mesh.uniform(em.Grid(n_xi=12, n_eta=20))
    assert np.abs(mesh.x - uniform.x).max() < 1e-12
    assert np.abs(mesh.y - uniform.y).max() < 1e-12


@pytest.mark.parametrize("shape", [(40, 171), (129, 65), (4, 5), (17, 17)])
def test_any_grid_has_a_map(shape: tuple[int, int]) -> None:
    steps = list(gradient_map_steps(problem("1 + 50*exp(-20*((x - 0.3)**2 + (y - 0.6)**2))", *shape)))
    assert steps[-1].converged
    assert steps[-1].mesh.x.shape == shape
    assert not any(step.mesh.is_folded for step in steps)
    assert [step.level for step in steps] == sorted(step.level for step in steps)
    assert steps[-1].level == steps[-1].levels - 1


def test_symmetry_of_the_weight_is_that_of_the_mesh() -> None:
    mesh = last(problem("1 + 100*exp(-50*((x - 0.5)**2 + (y - 0.5)**2))")).mesh
    assert np.abs(mesh.x - mesh.y.T).max() < 1e-9
    assert np.abs(mesh.x + mesh.x[::-1] - 1.0).max() < 1e-9


def test_shares_of_the_weight_are_equal_on_a_bent_domain() -> None:
    solution = em.solve(problem("1 + 9*exp(-20*((x - 1)**2 + (y - 1)**2))", 33, 41, em.AnnulusSector()))
    assert solution.status is em.Status.CONVERGED
    assert abs(solution.quality.q_eq.rms - 1.0) < 0.01
    flat = map_mesh(em.Mesh.uniform(solution.problem.grid), em.AnnulusSector())
    uniform = em.measure(flat, solution.problem.monitor)
    assert uniform.q_eq.rms > 1.1


def test_a_weight_that_is_not_reached_is_relaxed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradient_map, "MAX_MOVES", 2)
    solution = em.solve(problem(HARD["ring"]))
    assert solution.status is em.Status.RELAXED
    (relaxed,) = solution.relaxed
    assert relaxed.what == "strength"
    assert 0.0 < relaxed.reached < 1.0
    assert not solution.mesh.is_folded
    monkeypatch.setattr(gradient_map, "MIN_STRENGTH", 0.9)
    failed = em.solve(problem(HARD["ring"]), check=False)
    assert failed.status is em.Status.NEWTON_FAILED
    assert not failed.mesh.is_folded


def test_the_certificate_has_the_deviation_of_the_shares() -> None:
    solution = em.solve(problem(HARD["ring"], 65))
    certificate = solution.certificate
    assert certificate.status is em.Status.CONVERGED
    assert certificate.mode is None
    assert 0.0 < certificate.equation_residual == solution.residual <= MAX_DEVIATION
    assert solution.newton_steps > 3


def test_the_start_does_not_matter_and_subdomains_are_refused() -> None:
    of = problem(HARD["peak"])
    first = em.solve(of)
    again = em.solve(of, initial=first.reference)
    assert np.array_equal(first.mesh.x, again.mesh.x)
    assert again.detours == ()
    with pytest.raises(em.InputError, match="not made of subdomains") as caught:
        em.solve(of, em.Schwarz())
    assert caught.value.field == "schwarz"
    start = em.Mesh.uniform(of.grid)
    with pytest.raises(em.InputError, match="not made of subdomains"):
        next(schwarz_iterations(of, em.Schwarz(), start))


def test_smoothing_keeps_the_map() -> None:
    of = problem("where(x < 0.5, 1, 100)")
    smooth = em.Problem(monitor=em.Smoothed(monitor=of.monitor, radius=0.1), grid=of.grid)
    sharp, wide = em.solve(of), em.solve(smooth)
    assert wide.mode is None
    assert wide.status is em.Status.CONVERGED
    assert wide.quality.size_ratio.max < sharp.quality.size_ratio.max


def test_a_document_with_a_map_and_subdomains_is_refused() -> None:
    document = {"monitor": {"kind": "weight", "rho": {"expression": "1 + x"}, "map": "gradient"}}
    assert build(document).problem.monitor == problem("1 + x").monitor
    with pytest.raises(em.InputError) as caught:
        build({**document, "schwarz": {}})
    assert caught.value.field == "schwarz"
