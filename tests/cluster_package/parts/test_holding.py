"""Subdomains in several processes, here threads: the same iterations as in one process, and the bytes they say."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.rows import Rows
from equimesh.schwarz.iteration import iterations_on, schwarz_iterations
from equimesh.schwarz.records import Iteration, IterationNumbers
from equimesh.sweeps.sweep import Sweep, memory_needed
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.holding import OnChannel, WindowSweep, holder
from equimesh_cluster.parts.schwarz import cuts_of_rows, rows_of
from solver.schwarz.bent import bent

CASE = problem("tanh20", 25, 17)
# What the record of an iteration counts: not the numbers that all agree on, nor meshes that are shown or solved whole.
COUNTED = ("interfaces", "nodes", "sums", "pushes", "corrections")
SAME = ("iteration", "transmission", "accelerated", "global_step", "failed", "work", "traffic", "products")


@cache
def bent_case() -> em.Mesh:
    return bent(CASE, 0.004)


def held(
    case: em.Problem,
    settings: em.Schwarz,
    parts: int,
    count: int,
    *,
    start: em.Mesh | None = None,
    reference: em.Mesh | None = None,
) -> tuple[Sequence[IterationNumbers], list[dict[str, int]]]:
    """The first iterations as the first part has them, and the bytes that each part has sent."""

    def iterate(channel: Channel) -> tuple[list[IterationNumbers], dict[str, int]]:
        holding = OnChannel(channel, settings.decompose(case.grid), shows=True)
        exact = None if reference is None else holding.cut(reference)
        records = iterations_on(holding, case, settings, holding.cut(start or bent_case()), exact)
        return [record for record, _ in itertools.islice(records, count)], holding.sent

    found = ThreadChannels(parts).run(iterate)
    return found[0][0], [sent for _, sent in found]


def assert_same(here: IterationNumbers, there: Iteration, tolerance: float) -> None:
    assert isinstance(here, Iteration)
    apart = max(abs(here.reference.x - there.reference.x).max(), abs(here.reference.y - there.reference.y).max())
    assert apart <= tolerance
    assert all(getattr(here, name) == getattr(there, name) for name in SAME)
    for name in ("change", "estimate", "mismatch", "deviation", "min_jacobian"):
        assert getattr(here, name) == pytest.approx(getattr(there, name), rel=1e-6, abs=1e-12, nan_ok=True)
    counts = [[(r.newton_steps, r.sweeps, r.stalled, r.classical) for r in one.subdomains] for one in (here, there)]
    assert counts[0] == counts[1]


CONDITIONS = (em.Classical(), em.LinearRobin(), em.NonlinearRobin(), em.Optimized())
LAYOUTS = [((4, 1), 3), ((3, 2), 6)]


@pytest.mark.parametrize(
    ("condition", "subdomains", "parts"),
    [(condition, *LAYOUTS[k % 2]) for k, condition in enumerate(CONDITIONS)],
    ids=str,
)
def test_the_iterates_are_those_of_one_process(
    condition: em.TransmissionCondition, subdomains: tuple[int, int], parts: int
) -> None:
    """To the last bit; with corrections of whole lines, whose sums are added in another order, to rounding."""
    settings = em.Schwarz(subdomains=subdomains, transmission=condition)
    expected = list(itertools.islice(schwarz_iterations(CASE, settings, bent_case()), 3))
    found, sent = held(CASE, settings, parts, 3)
    corrected = any(math.isfinite(record.deviation) for record in expected)
    for here, there in zip(found, expected, strict=True):
        assert_same(here, there, 1e-13 if corrected else 0.0)
    if parts == subdomains[0] * subdomains[1]:
        assert sum(one.get(kind, 0) for one in sent for kind in COUNTED) == sum(record.traffic for record in expected)


@pytest.mark.parametrize("boundary", [em.Boundary.EQUIDISTRIBUTED_1D, em.Boundary.ORTHOGONAL])
def test_all_boundaries_and_line_corrections_of_blocks(boundary: em.Boundary) -> None:
    case = problem("tanh20", 29, 23, boundary=boundary)
    settings = em.Schwarz(subdomains=(2, 2), overlap=3, line_correction=2)
    start = bent(case, 0.004)
    expected = list(itertools.islice(schwarz_iterations(case, settings, start), 4))
    found, sent = held(case, settings, 4, 4, start=start)
    for here, there in zip(found, expected, strict=True):
        assert_same(here, there, 1e-13)
    assert sum(one.get(kind, 0) for one in sent for kind in COUNTED) == sum(record.traffic for record in expected)


@pytest.mark.parametrize(
    ("ordering", "condition"),
    [
        (em.Ordering.ALTERNATING, em.LinearRobin()),
        (em.Ordering.SYMMETRIC, em.Classical()),
        (em.Ordering.COLOURED, em.Optimized(data=em.LineData.LOCAL)),
        (em.Ordering.ALTERNATING, em.Optimized()),
    ],
    ids=str,
)
def test_turns_read_the_newest_data(ordering: em.Ordering, condition: em.TransmissionCondition) -> None:
    settings = em.Schwarz(
        subdomains=(2, 2), overlap=4, transmission=condition, ordering=ordering, line_correction=0, acceleration="none"
    )
    expected = list(itertools.islice(schwarz_iterations(CASE, settings, bent_case()), 3))
    found, sent = held(CASE, settings, 4, 3)
    for here, there in zip(found, expected, strict=True):
        assert_same(here, there, 0.0)
    assert sum(one.get(kind, 0) for one in sent for kind in COUNTED) == sum(record.traffic for record in expected)


@pytest.mark.parametrize(
    ("name", "points", "settings"),
    [
        pytest.param(
            *("wave", 13, em.Schwarz(subdomains=(2, 2), transmission=em.LinearRobin(), tolerance=1e-9)),
            marks=pytest.mark.everything,
            id="another condition takes over",
        ),
        pytest.param("tanh20", 17, em.Schwarz(subdomains=(2, 1), tolerance=1e-9), id="newton takes over"),
    ],
)
def test_steps_on_the_whole_grid_are_done_by_one_part(name: str, points: int, settings: em.Schwarz) -> None:
    """Far from the solution subdomains fail, merged meshes fold, and the iteration changes its ways."""
    case = problem(name, points)
    start = em.Mesh.uniform(case.grid)
    expected = list(itertools.islice(schwarz_iterations(case, settings, start), 5))
    assert any(record.global_step for record in expected)
    if isinstance(settings.transmission, em.LinearRobin):
        assert any(any(r.classical for r in record.subdomains) for record in expected)
        assert len({record.transmission for record in expected}) == 2
    else:
        assert expected[-1].products > 0
    found, sent = held(case, settings, 2, 5, start=start)
    for here, there in zip(found, expected, strict=True):
        assert_same(here, there, 1e-12)
    assert sum(one.get("whole", 0) for one in sent) > 0


def test_errors_against_a_reference_are_those_of_one_process() -> None:
    settings = em.Schwarz(subdomains=(3, 1), transmission=em.Classical())
    exact = bent(CASE, 0.0)
    expected = list(itertools.islice(schwarz_iterations(CASE, settings, bent_case(), exact), 3))
    found, _ = held(CASE, settings, 2, 3, reference=exact)
    assert [record.error for record in found] == [record.error for record in expected]
    errors = [[(r.error_x, r.error_y) for r in record.subdomains] for record in found]
    assert errors == [[(r.error_x, r.error_y) for r in record.subdomains] for record in expected]


@pytest.mark.parametrize("count", [8, pytest.param(32, marks=pytest.mark.everything)])
def test_results_do_not_depend_on_the_number_of_parts(count: int) -> None:
    case = problem("tanh20", 129, 17)
    settings, start = em.Schwarz(subdomains=(count, 1), overlap=3), bent(case, 0.002)
    meshes = []
    for parts in (1, 3, 8):
        last = held(case, settings, parts, 3, start=start)[0][-1]
        assert isinstance(last, Iteration)
        meshes.append(last.reference)
    assert all(np.array_equal(mesh.x, meshes[0].x) and np.array_equal(mesh.y, meshes[0].y) for mesh in meshes)


def test_a_part_holds_consecutive_subdomains_and_each_has_one() -> None:
    assert [holder(k, 7, 3) for k in range(7)] == [0, 0, 0, 1, 1, 2, 2]
    for processes in range(1, 9):
        assert {holder(k, 8, processes) for k in range(8)} == set(range(processes))

    def refused(channel: Channel) -> None:
        OnChannel(channel, em.Decomposition(grid=CASE.grid, subdomains=(2, 1)))

    with pytest.raises(em.InputError, match="3 parts for 2 subdomains: every part needs a subdomain"):
        ThreadChannels(3).run(refused)


def test_only_windows_are_held() -> None:
    decomposition = em.Decomposition(grid=CASE.grid, subdomains=(4, 1), overlap=4)
    sizes = ThreadChannels(4).run(lambda channel: OnChannel(channel, decomposition).size)
    assert max(sizes) <= (25 / 4 + 4 + 2) * 17


def test_the_sides_of_the_grid_are_closed_wherever_they_are() -> None:
    decomposition = em.Decomposition(grid=CASE.grid, subdomains=(2, 2), overlap=4)
    off = em.Mesh(bent_case().x + 1e-9, bent_case().y - 1e-9)

    def close(channel: Channel) -> em.Mesh | None:
        holding = OnChannel(channel, decomposition)
        mesh = holding.cut(off)
        holding.close_sides(mesh)
        return holding.assembled(mesh, "shown")

    found = ThreadChannels(3).run(close)[0]
    assert (found.x[0] == 0.0).all() and (found.x[-1] == 1.0).all()  # noqa: PT018
    assert (found.y[:, 0] == 0.0).all() and (found.y[:, -1] == 1.0).all()  # noqa: PT018
    assert np.array_equal(found.x[1:-1], off.x[1:-1]), "all other nodes stay"


# Line corrections in windows: those of a sweep on the whole grid.


SECTOR = em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0))


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("domain", [em.Rectangle(x=(0, 1), y=(0, 1)), SECTOR], ids=["square", "sector"])
def test_two_corrections_are_those_of_the_whole_grid(boundary: em.Boundary, domain: em.Domain) -> None:
    """From a mesh whose sides move, too: they push the ends of all lines."""
    square = problem("tanh20", 26, 21, boundary=boundary)
    case = em.Problem(monitor=square.monitor, grid=square.grid, boundary=boundary, domain=domain)
    start, shape = bent(case, 0.005), square.grid.shape
    whole = Sweep(case.metric, boundary, Rows.whole(shape), np.empty(memory_needed(shape)))
    x, y, expected = start.x.copy(), start.y.copy(), []
    for _ in range(2):
        found = whole.correct(x, y)
        smallest = whole.smallest_jacobian
        x, y = whole.swap(x, y)
        expected.append((found.deviation, found.move, smallest))
    decomposition = em.Decomposition(grid=case.grid, subdomains=(3, 2), overlap=2)

    def correct(channel: Channel) -> em.Mesh | None:
        holding = OnChannel(channel, decomposition)
        sweep, mesh = WindowSweep(case, holding), holding.cut(start)
        held_x, held_y = mesh.x, mesh.y
        for numbers in expected:
            here = sweep.correct(held_x, held_y)
            assert (here.deviation, here.move, sweep.smallest_jacobian) == pytest.approx(numbers, rel=1e-9)
            held_x, held_y = sweep.swap(held_x, held_y)
        return holding.assembled(em.Mesh(held_x, held_y), "shown")

    mesh = ThreadChannels(4).run(correct)[0]
    assert max(abs(mesh.x - x).max(), abs(mesh.y - y).max()) < 1e-14
    assert expected[0][1] > 1e-3, "the nodes do move"


# Windows become strips of rows.


GRID = em.Grid(n_xi=20, n_eta=13)


@pytest.mark.parametrize(("subdomains", "parts"), [((5, 1), 2), ((5, 1), 5), ((2, 3), 4), ((1, 3), 3)], ids=str)
def test_every_part_has_its_rows_and_one_more_each_way(subdomains: tuple[int, int], parts: int) -> None:
    decomposition = em.Decomposition(grid=GRID, subdomains=subdomains, overlap=2)
    mesh = em.Mesh(*np.random.default_rng(4).normal(size=(2, *GRID.shape)))

    def rows(channel: Channel) -> tuple[list[int], dict[str, int]]:
        holding = OnChannel(channel, decomposition)
        held, cuts = rows_of(holding, holding.cut(mesh)), cuts_of_rows(holding)
        number = channel.number
        assert (held.rows.begin, held.rows.end) == (max(cuts[number] - 1, 0), min(cuts[number + 1] + 1, 20))
        assert np.array_equal(held.x, mesh.x[held.rows.here])
        assert np.array_equal(held.y, mesh.y[held.rows.here])
        return cuts, holding.sent

    found = ThreadChannels(parts).run(rows)
    assert all(cuts == found[0][0] for cuts, _ in found)
    if subdomains[1] == 1:
        assert sum(sent["rows"] for _, sent in found) == 2 * (parts - 1) * 13 * 16, "strips stay where they are"


# The order in which neighbours pass on what is found along lines.
