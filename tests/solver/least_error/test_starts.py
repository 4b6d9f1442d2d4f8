"""Starts: first meshes of any size, straight lines that equidistribute the density of least error, and lifting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.least_error import starts
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import CurveChart, DomainChart
from equimesh.least_error.descent import StraightLines
from equimesh.least_error.kernels import Norm, Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.paved import Background, Boundary, background_counts
from equimesh.least_error.starts import Start, coordinates_of, mesh_of, product, rectilinear, resampled
from equimesh.rounds.norms import measured
from equimesh.testing.geometries import disc
from solver.bent import SECTOR, bent, uniform

SQUARE = em.Rectangle()
COARSE = em.Grid(n_xi=9, n_eta=7)
FINE = [em.Grid(n_xi=17, n_eta=13), em.Grid(n_xi=16, n_eta=7), em.Grid(n_xi=9, n_eta=12), em.Grid(n_xi=14, n_eta=13)]
GRADED = np.array([0.0, 0.001, 0.003, 0.01, 0.1, 0.4, 0.8, 1.0])
STRAIGHT = Start(name="rectilinear", s=GRADED, t=1.0 - GRADED[::-1])
EVEN = Start.uniform()


class Counted:
    """A field that counts how often it is evaluated: twice a pass."""

    def __init__(self, text: str) -> None:
        self.u, self.calls = em.Expression(text), 0

    def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
        self.calls += 1
        return self.u.evaluate(x, y, order)


def lines(text: str, count: int = 65, floor: float = 0.1, norm: str = "l2") -> tuple[np.ndarray, np.ndarray]:
    found = rectilinear(em.Expression(text), SQUARE, (count, count), norm, floor)  # type: ignore[arg-type]
    assert found is not None
    return found


@pytest.mark.parametrize(("norm", "power"), [("l2", 0.4), ("h1", 2 / 3)])
def test_lines_equidistribute_the_density_of_least_error(norm: str, power: float) -> None:
    # |u_xx|^(2/5) for exp(-x/w) is exp(-2 x/(5 w)), plus the floor times its mean.
    s, _ = lines("exp(-6*x)*(2 + y)", count=201, floor=0.1, norm=norm)
    mean = (1 - np.exp(-6 * power)) / (6 * power)
    integral = (1 - np.exp(-6 * power * s)) / (6 * power) + 0.1 * mean * s
    assert np.diff(integral) == pytest.approx(np.full(200, 1.1 * mean / 200), rel=0.02)


def test_what_does_not_depend_on_y_leaves_its_lines_alone() -> None:
    s, t = lines("tanh(30*(x - 0.4))")
    assert np.array_equal(t, np.linspace(0, 1, 65))
    assert np.diff(s).min() < 0.2 / 64


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4])
def test_layers_are_found(width: float) -> None:
    s, t = lines(f"exp(-x/{width}) + exp((y - 1)/{width})", floor=0.01)
    assert np.count_nonzero(s < 5 * width) > 20
    assert np.count_nonzero(t > 1 - 5 * width) > 20


@pytest.mark.parametrize(
    ("text", "passes"), [("exp(-x/0.1)", 4), ("exp(-x/0.001) + exp(-y/0.001)", 8), ("x + y", 1), ("x*x + y*y", 1)]
)
def test_it_takes_few_passes(text: str, passes: int) -> None:
    u = Counted(text)
    rectilinear(u, SQUARE, (33, 33), "l2", 0.1)
    assert u.calls <= 2 * passes


@pytest.mark.parametrize("text", ["abs(x - 0.3)", "tanh(300*(x + y - 1))", "1e200*tanh(50*x*y)", "1e-200*exp(-50*x)"])
@pytest.mark.parametrize("floor", [1.0, 0.1, 0.01])
def test_lines_keep_their_order_and_ends(text: str, floor: float) -> None:
    for line in lines(text, floor=floor):
        assert (line[0], line[-1]) == (0.0, 1.0)
        assert np.diff(line).min() > 0.0


def test_lines_at_equal_integrals_are_those_of_numpy() -> None:
    rng = np.random.default_rng(7)
    line, slopes = np.sort(np.append(rng.random(38), [0.0, 1.0])), rng.normal(size=(40, 9))
    integral, moved = np.empty(40), np.empty(40)
    change = starts.move(line, slopes, np.full(9, 0.1), (0.2, 0.1), False, integral, moved)
    assert np.array_equal(moved[1:-1], np.interp(np.linspace(0.0, integral[-1], 40), integral, line)[1:-1])
    steps = np.diff(line)
    assert change == np.max(np.abs(moved - line)[1:-1] / np.minimum(steps[1:], steps[:-1]))


def test_more_floor_leaves_more_lines_where_u_is_flat() -> None:
    flat = [np.count_nonzero(lines("tanh(100*(x - 0.3))", floor=floor)[0] > 0.4) for floor in (0.01, 0.1, 1.0)]
    assert flat[0] < flat[1] < flat[2]


def test_the_lines_of_a_sector_follow_its_radius() -> None:
    u = em.Expression("exp(-40*(hypot(x - 0.3, y + 0.4) - 0.6))")
    found = rectilinear(u, SECTOR, (33, 33), "l2", 0.1)
    assert found is not None
    graded = [np.diff(line).max() / np.diff(line).min() for line in found]
    assert sorted(graded)[0] == pytest.approx(1.0, abs=1e-6)
    assert sorted(graded)[1] > 5


def test_there_are_none_where_u_is_not_finite() -> None:
    with np.errstate(all="ignore"):
        assert rectilinear(em.Expression("log(x - 0.5)"), SQUARE, (9, 9), "l2", 0.1) is None


@pytest.mark.parametrize("text", ["sqrt(x)*(1 + y)", "(x**2 + y**2)**(1/3)"])
def test_infinite_slopes_on_a_side_draw_lines_to_it(text: str) -> None:
    with np.errstate(all="ignore"):
        s, _ = lines(text)
    assert np.diff(s)[0] == np.diff(s).min() < 0.3 / 64


def test_rounding_does_not_draw_lines() -> None:
    assert np.array_equal(lines("3*x + 5*y + 7")[0], np.linspace(0, 1, 65))


def test_resampling_keeps_lines_monotone_and_ends() -> None:
    line = np.array([0.0, 0.001, 0.002, 0.5, 0.9, 1.0])
    for count in (4, 6, 11, 40):
        fine = resampled(line, count)
        assert fine.size == count
        assert (fine[0], fine[-1]) == (0.0, 1.0)
        assert np.diff(fine).min() > 0.0
    assert resampled(line, 6) is line
    assert resampled(line, 11)[::2] == pytest.approx(line, abs=1e-15)
    assert resampled(np.array([0.0, 1.0]), 5) == pytest.approx(np.linspace(0, 1, 5), abs=0)


def test_a_product_has_straight_lines() -> None:
    mesh = product(np.array([0.0, 0.2, 1.0]), np.array([0.0, 1.0]))
    assert mesh.tolist() == [[0, 0, 0.2, 0.2, 1, 1], [0, 1, 0, 1, 0, 1]]


def test_passes_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starts, "MAX_PASSES", 2)
    u = Counted("exp(-x/0.0001)")
    rectilinear(u, SQUARE, (33, 33), "l2", 0.01)
    assert u.calls == 2  # one for both families, as few lines cross


def test_the_uniform_start_begins_with_uniform_meshes() -> None:
    for grid in (COARSE, *FINE):
        assert EVEN.first_mesh(grid) == pytest.approx(uniform(grid), abs=1e-15)
        assert EVEN.first_mesh(grid) is EVEN.first_mesh(grid)
    assert (EVEN.name, Start.uniform("given").name) == ("uniform", "given")


@pytest.mark.parametrize("origin", [EVEN, STRAIGHT], ids=lambda origin: origin.name)
@pytest.mark.parametrize("fine", FINE, ids=str)
def test_the_first_mesh_is_lifted_to_the_first_mesh(origin: Start, fine: em.Grid) -> None:
    assert origin.lifted(origin.first_mesh(COARSE), COARSE, fine) == pytest.approx(origin.first_mesh(fine), abs=1e-14)


@pytest.mark.parametrize("fine", FINE, ids=str)
def test_lifting_keeps_sides_and_does_not_fold(fine: em.Grid) -> None:
    for seed in range(20):
        lifted = EVEN.lifted(bent(COARSE, seed, share=0.45), COARSE, fine)
        mesh = mesh_of(lifted, fine)
        assert not mesh.is_folded
        for side in (mesh.x[0], 1 - mesh.x[-1], mesh.y[:, 0], 1 - mesh.y[:, -1]):
            assert (side == 0.0).all()


def test_smooth_displacements_are_lifted_by_cubics() -> None:
    def curved(grid: em.Grid) -> np.ndarray:
        s, t = uniform(grid)
        return np.stack([s + 0.4 * s * (1 - s) * t, t + 0.3 * t**2 * (1 - t)])

    for fine in FINE:
        assert EVEN.lifted(curved(COARSE), COARSE, fine) == pytest.approx(curved(fine), abs=1e-13)


def nearly_folded(grid: em.Grid, seed: int) -> np.ndarray:
    """A valid mesh with cells of nearly no area: the farthest way along a random direction."""
    away = bent(grid, seed, share=3.0) - uniform(grid)
    good, bad = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (good + bad)
        if mesh_of(uniform(grid) + middle * away, grid).min_jacobian > 1e-6:
            good = middle
        else:
            bad = middle
    return uniform(grid) + good * away


def test_a_mesh_that_is_nearly_folded_is_lifted_to_a_refined_grid_as_it_is() -> None:
    fine = em.Grid(n_xi=17, n_eta=13)
    for seed in range(20):
        mesh = nearly_folded(COARSE, seed)
        lifted = mesh_of(EVEN.lifted(mesh, COARSE, fine), fine)
        assert not lifted.is_folded
        # Each node of the coarse grid is one of the fine grid, and stays where it is.
        assert coordinates_of(em.Mesh(lifted.x[::2, ::2], lifted.y[::2, ::2])) == pytest.approx(mesh, abs=1e-12)


def test_coordinates_and_meshes_are_the_same() -> None:
    mesh = bent(COARSE)
    assert np.array_equal(coordinates_of(mesh_of(mesh, COARSE)), mesh)


def test_a_given_mesh_is_the_first_one_on_its_own_grid_alone() -> None:
    mesh = bent(COARSE)
    origin = Start.given(mesh_of(mesh, COARSE))
    assert np.array_equal(origin.first_mesh(COARSE), mesh)
    assert origin.first_mesh(FINE[0]) == pytest.approx(uniform(FINE[0]), abs=1e-15)
    assert origin.name == "given"


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_lines_for_a_degree_have_the_least_error_of_that_degree(norm: Norm) -> None:
    u, grid = em.Expression("tanh(30*(x - 0.4))"), em.Grid(33, 5)

    def errors(degree: int) -> list[float]:
        found = rectilinear(u, SQUARE, grid.shape, norm, 0.1, degree=degree)
        assert found is not None
        mesh = mesh_of(product(*found), grid)
        return [measured(u, SQUARE, mesh, Rule(norm=norm, points=6, degree=one)) for one in (1, 2, 3)]

    first, second, third = (errors(degree) for degree in (1, 2, 3))
    assert first[0] < 0.7 * second[0]
    assert second[1] < 0.8 * first[1]
    assert third[2] < 0.8 * second[2]


U = em.Expression("exp((x - 1)/0.1) + tanh(6*y - 2) + x*y")


def straight(shape: tuple[int, int]) -> tuple[StraightLines, np.ndarray]:
    s, t = (np.linspace(0.0, 1.0, n) for n in shape)
    weights = Weights(distortion=0.03, smoothness=0.02)
    objective = Objective(
        U, DomainChart(em.AnnulusSector()), cells_of_grid(shape), product(s, t), weights, Rule(points=3)
    )
    lines = StraightLines(objective, shape)
    return lines, lines.lines(product(s**1.2, t**0.8))


def test_the_derivatives_by_lines_are_those_of_the_objective() -> None:
    lines, at = straight((7, 5))
    there = lines.evaluate(at)
    assert there is not None
    step = 1e-6
    for axis, count in enumerate(lines.shape):
        for k in range(at.shape[1]):
            moved = np.zeros_like(at)
            moved[axis, k] = step
            is_free = 0 < k < count - 1
            if is_free:
                above, below = lines.evaluate(at + moved), lines.evaluate(at - moved)
                slope = (above.value - below.value) / (2 * step)
                assert there.gradient[axis, k] == pytest.approx(slope, rel=1e-5, abs=1e-7)
            else:
                assert there.gradient[axis, k] == 0.0


def test_lines_and_mesh_are_one_another() -> None:
    lines, at = straight((7, 5))
    assert np.array_equal(lines.lines(lines.mesh(at)), at)
    assert lines.smallest_share(at) > 0.0


@pytest.mark.parametrize("domain", [em.Rectangle(x=(0.0, 2.0)), em.AnnulusSector()], ids=["rectangle", "annulus"])
def test_a_rectilinear_mesh_has_straight_lines_and_a_smaller_error_than_its_start(domain: em.Domain) -> None:
    layers = em.Expression("exp((1 - hypot(x, y))/0.05) + exp(-3*y)")
    monitor = em.LeastError(u=layers, rectilinear=True)
    solution = em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=25, n_eta=17), domain=domain))
    assert np.ptp(solution.reference.x, axis=1).max() == 0.0
    assert np.ptp(solution.reference.y, axis=0).max() == 0.0
    assert solution.interpolation.gain_l2 > 1.5
    last = [row for row in solution.descent if row["grid"] == [25, 17]]
    assert last[-1]["error"] < last[0]["error"]
    free = em.solve(replace(solution.problem, monitor=replace(monitor, rectilinear=False)))
    assert np.ptp(free.reference.x, axis=1).max() > 0.0


def test_a_rectilinear_mesh_of_a_rectangle_is_orthogonal_also_from_a_given_mesh() -> None:
    layers = em.Expression("exp(-x/0.02) + exp(-y/0.02)")
    problem = em.Problem(monitor=em.LeastError(u=layers, rectilinear=True), grid=em.Grid(n_xi=17, n_eta=17))
    oblique = em.solve(replace(problem, monitor=em.LeastError(u=em.Expression("tanh(9*(x - y))"))))
    for initial in (em.Initial.NESTED, em.Initial.UNIFORM, oblique.reference):
        solution = em.solve(problem, initial=initial)
        assert np.ptp(solution.mesh.x, axis=1).max() == np.ptp(solution.mesh.y, axis=0).max() == 0.0
        assert solution.faces.non_orthogonality < 1e-5  # degrees, of the arc cosine of 1 to rounding
        assert solution.interpolation.gain_l2 > 10.0


RANDOM = np.random.default_rng(7)


def boundary_of(domain: Blocks) -> tuple[Boundary, CurveChart, np.ndarray]:
    chart = CurveChart(domain.curves, domain.node_curve, domain.node_parameter, domain.area)
    first = chart.unknowns(np.ascontiguousarray(domain.mesh.points.T), domain.node_parameter)
    return Boundary(chart, first, domain.mesh.cells), chart, first


def test_pulling_back_is_the_transpose_of_moving() -> None:
    domain = disc(400)
    boundary, _, _ = boundary_of(domain)
    background = Background(boundary, np.ascontiguousarray(domain.mesh.points.T), 4)
    coefficients, gradient = RANDOM.normal(size=(2, background.count)), RANDOM.normal(size=(2, domain.points))
    one = np.vdot(background.moves(coefficients), gradient)
    assert abs(one - np.vdot(coefficients, background.pulled_back(gradient))) < 1e-11 * abs(one)


def test_a_small_rotation_of_a_disc_slides_its_boundary_and_turns_all_nodes() -> None:
    domain = disc(400)
    boundary, chart, first = boundary_of(domain)
    x, y = domain.mesh.points.T
    moves = boundary.moves(1e-5 * np.stack([-y, x]))
    after = np.stack(chart.nodes(first + moves)) - domain.mesh.points.T
    assert np.abs(after - 1e-5 * np.stack([-y, x])).max() < 1e-9


def test_background_grids_double_while_their_cells_have_nodes_enough() -> None:
    assert background_counts(16 * 16 * 9, 4, 9.0) == [4, 8, 16]
    assert background_counts(20, 4, 9.0) == [4]
