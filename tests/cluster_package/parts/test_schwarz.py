"""Schwarz iterations and least error in parts: the mesh of one process, its records, and what happens after a loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.least_error.cells import Region, cells_of_grid, regions_of
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.restricted import RestrictedDescent, Subdomains
from equimesh.numerics.types import Array
from equimesh.schwarz.records import Iteration, IterationNumbers
from equimesh.solving.status import Event
from equimesh.testing.geometries import obstacle
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.checkpoints import Checkpoints, keep, resumed
from equimesh_cluster.parts.holding import OnChannel
from equimesh_cluster.parts.least_error import PartDescent, PartSubdomains, holders
from equimesh_cluster.parts.schwarz import (
    BlocksResult,
    SchwarzPart,
    SchwarzPlan,
    iterate_part,
    plain,
    solve_part_of_blocks,
)
from solver.bent import objective_on, uniform
from solver.schwarz.bent import bent

SECTOR = em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0))
SQUARE = problem("tanh20", 25, 17)
CASE = em.Problem(monitor=SQUARE.monitor, grid=SQUARE.grid, domain=SECTOR)


@cache
def bent_case() -> em.Mesh:
    return bent(CASE, 0.001)


def plan(schwarz: em.Schwarz, *, shows: bool = False) -> SchwarzPlan:
    tolerance = schwarz.tolerance if isinstance(schwarz.tolerance, float) else None
    return SchwarzPlan(problem=CASE, schwarz=schwarz, tolerance=tolerance, expected=math.nan, shows=shows)


def run(
    made: SchwarzPlan,
    parts: int,
    kept: list[Checkpoints] | None = None,
    observe: Callable[[int, IterationNumbers], None] | None = None,
) -> list[SchwarzPart]:
    def part(channel: Channel) -> SchwarzPart:
        windows = made.windows(bent_case(), channel.number, channel.count)
        copies = None if kept is None else kept[channel.number]
        watch = None if observe is None else lambda record: observe(channel.number, record)
        return iterate_part(channel, made, windows, kept=copies, observe=watch)

    return ThreadChannels(parts).run(part)


def joined(parts: list[SchwarzPart]) -> tuple[np.ndarray, np.ndarray]:
    x, y = (np.concatenate([getattr(part.mesh, q)[part.mesh.own_rows] for part in parts]) for q in "xy")
    return x, y


@pytest.mark.parametrize(("subdomains", "parts"), [((4, 1), 2), ((2, 2), 3)], ids=str)
def test_the_rows_of_all_parts_are_the_mesh_of_one_process(subdomains: tuple[int, int], parts: int) -> None:
    schwarz = em.Schwarz(subdomains=subdomains, tolerance=1e-10)
    solution = em.solve(CASE, schwarz, initial=bent_case())
    found = run(plan(schwarz), parts)
    x, y = joined(found)
    assert max(abs(x - solution.mesh.x).max(), abs(y - solution.mesh.y).max()) < 1e-12
    for part in found:
        held = part.reference.rows.here
        assert abs(part.reference.x - solution.reference.x[held]).max() < 1e-12
        assert (part.status, part.note, part.remedy) == (em.Status.CONVERGED, "", "")
        assert part.newton_steps == solution.newton_steps
        assert len(part.iterations) == len(solution.iterations)
        assert part.resumed is None
        assert not any(isinstance(record, Iteration) for record in part.iterations), "meshes stay where they are"


def test_meshes_of_records_are_assembled_where_they_are_shown() -> None:
    seen: list[IterationNumbers] = []
    schwarz = em.Schwarz(subdomains=(2, 1), tolerance=None, max_iterations=2)
    found = run(
        plan(schwarz, shows=True), 2, observe=lambda number, record: seen.append(record) if not number else None
    )
    assert found[0].status is em.Status.COMPLETED
    assert [record.iteration for record in seen] == [0, 1, 2]
    assert isinstance(seen[2], Iteration)
    x, y = joined(found)
    assert np.array_equal(seen[2].mesh.x, x)
    assert np.array_equal(seen[2].mesh.y, y)


SLOW = em.Schwarz(subdomains=(3, 1), overlap=7, transmission=em.Classical(), fallback=False, tolerance=1e-6)


class Killed(Exception):
    """A part that is lost."""


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_after_a_loss_the_iteration_goes_on_from_its_last_iterate(lost: int) -> None:
    """With one part less: the copies of the others have the windows of the lost one."""
    made, kept, numbers = plan(SLOW), [Checkpoints() for _ in range(3)], list[int]()

    def kill(number: int, record: IterationNumbers) -> None:
        if number == lost and record.iteration == 5:
            raise Killed

    with pytest.raises(Killed):
        run(made, 3, kept, kill)
    left = [copies for number, copies in enumerate(kept) if number != lost]
    found = run(made, 2, left, lambda number, record: numbers.append(record.iteration) if not number else None)
    assert found[0].resumed in (4, 5)
    assert numbers[0] == found[0].resumed + 1
    assert f"went on from the mesh of iteration {found[0].resumed}" in found[0].note
    assert found[0].status is em.Status.CONVERGED
    exact = em.solve(CASE, mode=em.Mode.TIGHT).mesh
    x, y = joined(found)
    assert max(abs(x - exact.x).max(), abs(y - exact.y).max()) < 1e-5
    whole = em.solve(CASE, SLOW, initial=bent_case())
    assert abs(numbers[-1] - (len(whole.iterations) - 1)) <= 2, "no iteration is done again"


def test_without_copies_it_begins_again() -> None:
    schwarz = em.Schwarz(subdomains=(2, 1), tolerance=None, max_iterations=2)
    found = run(plan(schwarz), 2, [Checkpoints(), Checkpoints()])
    assert (found[0].resumed, len(found[0].iterations)) == (None, 3)
    windows = sum(
        x.nbytes + y.nbytes for x, y in ((m.x, m.y) for m in plan(schwarz).windows(bent_case(), 0, 2).values())
    )
    assert found[0].sent[1]["kept"].bytes == windows
    assert found[0].sent[0]["kept"].bytes == 0, "the start is known"
    assert "kept" not in found[0].sent[2], "nothing goes on from the last mesh"


def test_newton_steps_of_large_grids_are_refused() -> None:
    fine = problem("tanh20", 513)
    with pytest.raises(em.InputError, match=r"whole meshes of at most 66049 points, and this grid has 263169"):
        SchwarzPlan(problem=fine, schwarz=em.Schwarz(acceleration="newton"), tolerance=None, expected=math.nan)


def test_closed_lines_are_refused() -> None:
    monitor = em.ArcLength(u=em.Expression("sin(2*pi*y)"))
    closed = replace(CASE, monitor=monitor, domain=em.Rectangle(periodic="y"))
    with pytest.raises(em.InputError, match="the subdomains of a Schwarz iteration end at sides"):
        SchwarzPlan(problem=closed, schwarz=SLOW, tolerance=None, expected=math.nan)


# Blocks in parts: the solution of one process, bit for bit, with its records, also where weights are chosen.


FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
DOMAIN = obstacle(600)
SETTINGS = em.Schwarz(groups=[[0, 1, 2], [3], [4, 5], [6, 7]])


MONITORS = {
    "given": em.LeastError(u=FRONT, smoothness=0.3),
    "chosen": em.Auto(u=FRONT),
    "bounded": em.LeastError(u=FRONT, orthogonality=50.0),
}


@pytest.mark.parametrize("monitor", MONITORS.values(), ids=MONITORS)
def test_the_solution_is_that_of_one_process(monitor: em.LeastError | em.Auto) -> None:
    problem = em.Problem(monitor=monitor, domain=DOMAIN)
    alone = em.solve(problem, SETTINGS, threads=1)
    events: list[Event] = []

    def work(channel: Channel) -> BlocksResult | None:
        observe = events.append if channel.number == 0 else None
        return solve_part_of_blocks(channel, problem, SETTINGS, observe=observe)

    found, *others = ThreadChannels(3).run(work)
    assert others == [None, None]
    solution = found.solution(problem)
    assert np.array_equal(solution.mesh.points, alone.mesh.points)
    assert solution.descent == alone.descent
    assert solution.comparison == alone.comparison
    assert solution.schwarz == SETTINGS
    told = [plain(event) for event in events if isinstance(event, em.Descent)]
    assert told[-1]["points"] == DOMAIN.points
    assert 0.0 < (told[-1]["fraction"] or 1.0) <= 1.0
    assert "mesh" not in told[-1]


def test_an_error_of_the_leader_ends_the_parts_that_follow() -> None:
    problem = em.Problem(monitor=em.LeastError(u=FRONT), domain=DOMAIN)

    def fail(_: Event) -> None:
        raise RuntimeError("the observer is tired")

    def work(channel: Channel) -> BlocksResult | None:
        return solve_part_of_blocks(channel, problem, SETTINGS, observe=fail if channel.number == 0 else None)

    with pytest.raises(RuntimeError, match="tired"):
        ThreadChannels(2).run(work)


STRIPS = em.Decomposition(grid=em.Grid(n_xi=20, n_eta=6), subdomains=(5, 1), overlap=2)


def mesh(iteration: int) -> em.Mesh:
    uniform = em.Mesh.uniform(STRIPS.grid)
    return em.Mesh(uniform.x + iteration, uniform.y - iteration)


def kept_by(parts: int, iterations: int) -> list[Checkpoints]:
    def work(channel: Channel) -> Checkpoints:
        holding, kept = OnChannel(channel, STRIPS), Checkpoints()
        for iteration in range(1, iterations + 1):
            keep(holding, kept, iteration, holding.cut(mesh(iteration)))
        return kept

    return ThreadChannels(parts).run(work)


def found(kept: list[Checkpoints], most: int = 99) -> int | None:
    """The iteration that is found; every part gets its windows of it."""

    def work(channel: Channel) -> int | None:
        holding = OnChannel(channel, STRIPS)
        here = resumed(holding, kept[channel.number], most)
        if here is None:
            return None
        expected = holding.cut(mesh(here[0]))
        assert np.array_equal(here[1].x, expected.x)
        assert np.array_equal(here[1].y, expected.y)
        return here[0]

    results = ThreadChannels(len(kept)).run(work)
    assert len(set(results)) == 1
    return results[0]


def test_two_iterates_are_kept_here_and_at_the_partner() -> None:
    kept = kept_by(4, 3)
    assert {iteration for iteration, _ in kept[0].known} == {2, 3}
    assert {k for _, k in kept[0].known} == {0, 1, 3}, "its own two, and the one of the part two further"


def test_any_part_may_be_lost() -> None:
    for lost in range(4):
        kept = [one for number, one in enumerate(kept_by(4, 3)) if number != lost]
        assert found(kept) == 3
        assert found(kept, most=2) == 2
        assert found(kept, most=1) is None


def test_partners_that_are_both_lost_take_their_windows_with_them() -> None:
    kept = kept_by(4, 3)
    assert found([kept[0], kept[1]]) == 3
    assert found([kept[0], kept[2]]) is None
    assert found([Checkpoints(), Checkpoints()]) is None


def test_an_iterate_that_not_all_have_kept_is_left_for_the_one_before() -> None:
    kept = kept_by(2, 3)
    kept[0].put(4, 0, [np.zeros((2, 2)), np.zeros((2, 2))])
    assert found(kept) == 3


GRID = em.Grid(n_xi=25, n_eta=21)
DESCENT = em.Schwarz(overlap=3, local_steps=4, max_exchanges=2)
BLOCKS = obstacle(1500)


def regions(closed: tuple[bool, bool] = (False, False)) -> tuple[Region, ...]:
    i, j = np.arange(GRID.n_xi - 1) * 3 // GRID.n_xi, np.arange(GRID.n_eta - 1) * 2 // GRID.n_eta
    return regions_of(cells_of_grid(GRID.shape, closed), (i[:, None] * 2 + j).ravel(), 4)


def objective(is_closed: bool) -> Objective:
    if not is_closed:
        return objective_on(GRID)
    weights, cells = Weights(distortion=0.06, smoothness=0.1), cells_of_grid(GRID.shape, (True, False))
    wave = em.Expression("tanh(10*(y - 0.5 - 0.2*sin(2*pi*x)))")
    return Objective(wave, DomainChart(em.Rectangle()), cells, uniform(GRID), weights, Rule())


@pytest.mark.parametrize("parts", [2, 3, 6])
@pytest.mark.parametrize("is_closed", [False, True])
def test_the_mesh_does_not_depend_on_parts(parts: int, is_closed: bool) -> None:
    shared = regions((is_closed, False))

    def mesh_of(descent: RestrictedDescent) -> Array:
        return descent.whole(list(descent.descend(uniform(GRID), 2, 4, 0.0))[-1][0])

    def work(channel: Channel) -> Array:
        return mesh_of(PartDescent(objective(is_closed), shared, 1, channel))

    one = mesh_of(RestrictedDescent(objective(is_closed), shared))
    for other in ThreadChannels(parts).run(work):
        assert np.array_equal(other, one)


@pytest.mark.parametrize("parts", [1, 2, 4, 6, 7])
def test_parts_hold_consecutive_regions_of_about_as_many_cells(parts: int) -> None:
    found = holders(regions(), parts)
    assert found == sorted(found)
    assert set(found) == set(range(min(parts, 6)))


# One part that leads, and others that follow.


def solve_on(channel: Channel | None, smoothness: float = 1.0) -> LeastErrorSolve:
    subdomains = Subdomains(settings=DESCENT) if channel is None else PartSubdomains(settings=DESCENT, channel=channel)
    monitor = em.LeastError(u=FRONT, smoothness=smoothness).on(BLOCKS)
    return LeastErrorSolve(monitor=monitor, domain=BLOCKS, subdomains=subdomains)


def points_of(records: list[Descent]) -> Array:
    mesh = records[-1].mesh
    assert isinstance(mesh, em.Mesh)
    return mesh.points


@pytest.mark.parametrize("parts", [2, 3])
def test_parts_that_follow_share_the_work_and_the_mesh_stays_the_same(parts: int) -> None:
    alone = list(solve_on(None, 0.5).steps())

    def work(channel: Channel) -> list[Descent] | int:
        if channel.number == 0:
            records = list(solve_on(channel, 0.5).steps())
            PartSubdomains(settings=DESCENT, channel=channel).dismiss()
            return records
        followed = 0
        for weights, start, first in PartSubdomains(settings=DESCENT, channel=channel).orders():
            assert weights[:2] == [em.LeastError.distortion, 0.5]
            solve_on(channel).with_weights(weights).follow(start, first)
            followed += 1
        return followed

    records, *followed = ThreadChannels(parts).run(work)
    assert isinstance(records, list)
    assert np.array_equal(points_of(records), points_of(alone))
    assert [record.error for record in records] == [record.error for record in alone]
    assert followed == [1] * (parts - 1)
