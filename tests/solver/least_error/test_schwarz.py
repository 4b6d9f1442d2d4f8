"""Least error whose subdomains descend, of a grid or of blocks: as good as the whole, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import restricted
from equimesh.least_error.cells import Cells, Region, cells_of_grid, regions_of
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.descent import Descent, descend
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.restricted import Merged, RestrictedDescent, Subdomains, owners
from equimesh.meshes.cell_edges import originals_of, quads_of_block
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh.specs import build, subdomains_of
from equimesh.testing.geometries import l_shape, obstacle
from solver.bent import RING, bent, objective_on, uniform

FRONT = "tanh(30*(y - 0.5 - 0.2*sin(2*pi*x)))"
FUNCTIONS = (FRONT, "exp(-x/0.02) + exp(-y/0.05)", "exp(-60*((x - 0.4)**2 + (y - 0.6)**2))")
MOST_ERROR = 1.05
"""The error with subdomains, at most, over that of the whole grid."""


def problem(u: str = FRONT, points: int = 25, domain: em.Domain | None = None, **settings: Any) -> em.Problem:
    grid = em.Grid(n_xi=points, n_eta=points)
    monitor = em.LeastError(u=em.Expression(u), **settings)
    return (
        em.Problem(monitor=monitor, grid=grid)
        if domain is None
        else em.Problem(monitor=monitor, grid=grid, domain=domain)
    )


@cache
def whole_grid(u: str = FRONT) -> em.Solution:
    """The solution without subdomains."""
    return em.solve(problem(u), threads=1)


def errors_of(solution: em.Solution) -> Any:
    errors = solution.interpolation
    assert errors is not None
    return errors


@pytest.mark.parametrize("u", FUNCTIONS)
@pytest.mark.parametrize("subdomains", [(2, 2), (3, 1), ((5, 12), 2)])
def test_subdomains_find_a_mesh_as_good_as_the_whole_grid(u: str, subdomains: Any) -> None:
    whole = whole_grid(u)
    divided = em.solve(problem(u), em.Schwarz(subdomains=subdomains, overlap=3), threads=1)
    assert divided.status is em.Status.COMPLETED
    assert not divided.mesh.is_folded
    assert errors_of(divided).l2 <= MOST_ERROR * errors_of(whole).l2
    assert divided.mesh.distance(whole.mesh) > 1e-6  # the subdomains have descended


@pytest.mark.parametrize(
    ("domain", "settings"),
    [
        (em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 120.0)), {}),
        (em.AnnulusSector(radii=(1.0, 2.0), closed=True), {}),
        (em.Rectangle(periodic="x"), {"norm": "h1"}),
        (em.Rectangle(), {"cells": "triangle"}),
    ],
)
def test_curved_sides_closed_lines_and_triangles_have_subdomains(domain: em.Domain, settings: dict[str, Any]) -> None:
    u = "tanh(8*(y - 0.5)) + 0.1*sin(2*pi*x)"
    asked = problem(u, domain=domain, **settings)
    whole, divided = em.solve(asked, threads=1), em.solve(asked, em.Schwarz(subdomains=(2, 2)), threads=2)
    norm = settings.get("norm", "l2")
    assert not divided.mesh.is_folded
    assert getattr(errors_of(divided), norm) <= 1.1 * getattr(errors_of(whole), norm)
    assert errors_of(divided).gain_l2 >= 1.0


def test_the_uniform_start_is_tried_where_the_other_one_is_folded() -> None:
    slit = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 360.0))
    monitor = em.LeastError(em.Expression("exp(-20*((x - 1.5)**2 + y**2))"), degree=3)
    solution = em.solve(em.Problem(monitor, em.Grid(9, 17), domain=slit), em.Schwarz(subdomains=(2, 2)), threads=1)
    assert {record["start"] for record in solution.descent} == {"rectilinear", "uniform"}
    assert not solution.mesh.is_folded
    assert errors_of(solution).gain_l2 > 50.0


def test_exchanges_are_records_with_progress() -> None:
    heard: list[Descent] = []
    settings = em.Schwarz(subdomains=(2, 2), local_steps=4, max_exchanges=3)
    solution = em.solve(problem(), settings, observe=heard.append)  # type: ignore[arg-type]
    finest = [record for record in heard if record.level + 1 == record.levels]
    assert [record.step for record in finest] == [0, 1, 2, 3]
    assert {record.steps for record in finest} == {3}
    assert all(after.error < before.error for before, after in pairwise(finest))
    assert [record.numbers() for record in heard] == list(solution.descent)
    fractions = [record.fraction for record in heard]
    assert fractions == sorted(fractions)  # type: ignore[type-var]
    assert fractions[-1] == 1.0


def test_an_observer_can_end_the_exchanges() -> None:
    class Cancelled(Exception):
        pass

    def observe(event: Any) -> None:
        if event.level + 1 == event.levels and event.step == 1:
            raise Cancelled

    with pytest.raises(Cancelled):
        em.solve(problem(), em.Schwarz(subdomains=(2, 2)), observe=observe)


def test_a_given_mesh_is_the_start_of_the_subdomains() -> None:
    first = whole_grid()
    again = em.solve(problem(), em.Schwarz(subdomains=(2, 2)), initial=first.reference, threads=1)
    assert errors_of(again).l2 <= errors_of(first).l2 * (1.0 + 1e-12)


def test_files_and_pictures_know_the_subdomains() -> None:
    solution = em.solve(problem(), em.Schwarz(subdomains=(2, 1), overlap=64), threads=1)
    owner = solution.data().subdomain
    assert np.array_equal(np.unique(owner[:12]), [0])
    assert np.array_equal(np.unique(owner[12:]), [1])
    assert solution.predicted_rate is None


@pytest.mark.parametrize(
    ("settings", "field", "words"),
    [
        ({"groups": [["a"]]}, "groups", "settings of blocks"),
        ({"overlap": 0}, "overlap", "a whole number from 1 to 64"),
        ({"overlap": 65}, "overlap", "a whole number from 1 to 64"),
        ({"subdomains": (13, 1)}, "subdomains", "13 subdomains in xi .* give 1 to 12"),
        ({"subdomains": (0, 1)}, "subdomains", "give 1 to 12"),
        ({"subdomains": ((24,), 1)}, "subdomains", "subdomains meet at line 24 in xi"),
    ],
)
def test_subdomains_that_do_not_fit_are_refused(settings: dict[str, Any], field: str, words: str) -> None:
    with pytest.raises(em.InputError, match=words) as caught:
        em.solve(problem(), em.Schwarz(**settings))
    assert caught.value.field == f"schwarz.{field}"


DOCUMENT = {
    "monitor": {"kind": "least_error", "u": FRONT},
    "grid": {"n_xi": 25, "n_eta": 25},
    "schwarz": {"subdomains": [2, 2], "overlap": 3, "local_steps": 4, "max_exchanges": 2},
}


def test_a_document_asks_for_the_same_mesh() -> None:
    settings = em.Schwarz(subdomains=(2, 2), overlap=3, local_steps=4, max_exchanges=2)
    built = build(DOCUMENT)
    assert built.schwarz == settings
    assert built.grid_schwarz is None
    assert np.array_equal(built.solve().mesh.points, em.solve(problem(), settings).mesh.points)
    rectangles = subdomains_of(DOCUMENT)
    assert rectangles.subdomains == (2, 2)


# Blocks in groups, and which setting belongs to what.

ROW = np.arange(4 * 3).reshape(4, 3)


def row_of_blocks() -> Mesh:
    """Three blocks in a row, of one column of two cells each; cells are in another order than blocks."""
    blocks = tuple(ROW[k : k + 2] for k in (2, 0, 1))
    points = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij"), axis=-1).reshape(-1, 2)
    return Mesh(points=points, cells=quads_of_block(ROW), sides={}, blocks=blocks, block_names=("c", "a", "b"))


def test_each_block_is_a_subdomain_unless_groups_say_otherwise() -> None:
    mesh = row_of_blocks()
    assert owners(em.Schwarz(), mesh).tolist() == [1, 1, 2, 2, 0, 0]
    for groups in ([["a", "c"], ["b"]], (("a", 0), (2,))):
        assert owners(em.Schwarz(groups=groups), mesh).tolist() == [0, 0, 1, 1, 0, 0]


@pytest.mark.parametrize(
    ("groups", "field", "words"),
    [
        ([["a", "b"]], "schwarz.groups", "the block c is in no group"),
        ([["a", "b"], ["c", 1]], "schwarz.groups", "the block a is in two groups"),
        ([["a", "b"], ["d"]], "schwarz.groups[1]", "no block d: the blocks are c, a, b"),
        ([["a", "b"], [3]], "schwarz.groups[1]", "no block 3"),
        ([["a", "b"], [True]], "schwarz.groups[1]", "no block True"),
    ],
)
def test_groups_that_are_no_partition_are_refused(groups: Any, field: str, words: str) -> None:
    with pytest.raises(em.InputError, match=words) as caught:
        owners(em.Schwarz(groups=groups), row_of_blocks())
    assert caught.value.field == field


@pytest.mark.parametrize("name", ["overlap", "local_steps", "max_exchanges"])
@pytest.mark.parametrize("value", [0, 2.0, True, "4", 10**6])
def test_numbers_of_the_wrong_kind_are_refused(name: str, value: Any) -> None:
    with pytest.raises(em.InputError, match=f"{name} = ") as caught:
        em.Schwarz(**{name: value}).require_blocks()
    assert caught.value.field == f"schwarz.{name}"


@pytest.mark.parametrize("groups", [[], "ab", [[]], ["a", "b"]])
def test_groups_of_the_wrong_kind_are_refused(groups: Any) -> None:
    with pytest.raises(em.InputError, match="a list of groups"):
        em.Schwarz(groups=groups)


def test_exchanges_take_the_steps_of_the_whole_mesh_unless_a_number_is_given() -> None:
    assert [em.Schwarz().exchanges(steps) for steps in (1, 8, 9, 30)] == [1, 1, 2, 4]
    assert em.Schwarz(max_exchanges=3).exchanges(30) == 3


OF_GRIDS: dict[str, Any] = {
    "subdomains": (2, 2),
    "transmission": em.Classical(),
    "ordering": "alternating",
    "line_correction": 1,
    "acceleration": "none",
    "local_solver": "newton",
    "fallback": False,
    "tolerance": 1e-6,
    "max_iterations": 5,
    "compare_single_domain": True,
}
OF_BLOCKS: dict[str, Any] = {"local_steps": 4, "max_exchanges": 3, "groups": [["a", "b"]]}


def test_each_setting_belongs_to_grids_or_to_blocks_or_to_both() -> None:
    assert {*OF_GRIDS, *OF_BLOCKS, "overlap"} == {one.name for one in fields(em.Schwarz)}


@pytest.mark.parametrize(
    ("name", "on_blocks"), [(name, on) for name in OF_GRIDS for on in (True, False) if on or name != "subdomains"]
)
def test_settings_of_equidistribution_are_refused_with_what_to_give(name: str, on_blocks: bool) -> None:
    blocks = em.Problem(monitor=em.LeastError(u=em.Expression("tanh(9*x)")), domain=l_shape(100))
    remedy = "group blocks" if on_blocks else "give subdomains"
    with pytest.raises(em.InputError, match=f"^{name} is one of .* leave it out, and {remedy}") as caught:
        em.solve(blocks if on_blocks else problem(), em.Schwarz(**{name: OF_GRIDS[name]}))
    assert caught.value.field == f"schwarz.{name}"


@pytest.mark.parametrize("name", OF_BLOCKS)
def test_settings_of_a_descent_are_refused_where_grids_are_equidistributed(name: str) -> None:
    asked = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(9*x)")), grid=em.Grid(n_xi=9, n_eta=9))
    with pytest.raises(em.InputError, match=f"^{name} is one of the settings of (blocks|least error)") as caught:
        em.solve(asked, em.Schwarz(**{name: OF_BLOCKS[name]}))
    assert caught.value.field == f"schwarz.{name}"


STEEP_FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
SETTINGS = em.Schwarz(overlap=3, local_steps=4, max_exchanges=2)
DOMAIN = obstacle(1500)


def solve() -> LeastErrorSolve:
    monitor = em.LeastError(u=STEEP_FRONT).on(DOMAIN)
    return LeastErrorSolve(monitor=monitor, domain=DOMAIN, subdomains=Subdomains(settings=SETTINGS))


def test_only_the_finest_mesh_has_subdomains_and_its_records_count_exchanges() -> None:
    subdomains, whole = (list(solve().steps()), list(LeastErrorSolve(monitor=solve().monitor, domain=DOMAIN).steps()))
    finest = [record for record in subdomains if record.level == record.levels - 1]
    coarse = [record.error for record in subdomains if record.level < record.levels - 1]
    assert coarse == [record.error for record in whole if record.level < record.levels - 1]
    assert [(record.step, record.steps) for record in finest] == [(0, 2), (1, 2), (2, 2)]
    assert finest[0].error > finest[1].error > finest[2].error


SHAPE = (14, 11)
CLOSED = [(False, False), (True, False), (True, True)]


def owned(columns: int = 3, rows: int = 2) -> IntArray:
    """The owner of each cell of the grid, in blocks of unequal sizes."""
    i, j = np.arange(SHAPE[0] - 1) * columns // SHAPE[0], np.arange(SHAPE[1] - 1) * rows // SHAPE[1]
    return (i[:, None] * rows + j).ravel()


def cells_in_mesh(region: Region, cells: Cells) -> IntArray:
    """The numbers in the mesh of the cells of a region."""
    numbers = {tuple(corners): number for number, corners in enumerate(cells.corners.tolist())}
    return np.array([numbers[tuple(corners)] for corners in region.nodes[region.cells.corners].tolist()])


@pytest.mark.parametrize("closed", CLOSED)
def test_every_cell_node_and_triple_has_one_owner(closed: tuple[bool, bool]) -> None:
    cells, owner = cells_of_grid(SHAPE, closed), owned()
    regions = regions_of(cells, owner, 2)
    nodes = np.concatenate([region.nodes[region.owned] for region in regions])
    assert np.array_equal(np.sort(nodes), np.arange(cells.nodes))
    for region in regions:
        assert np.array_equal(cells_in_mesh(region, cells)[: region.own_cells], np.flatnonzero(owner == region.number))
    assert sum(region.own_triples for region in regions) == len(cells.triples)


@pytest.mark.parametrize("closed", CLOSED)
@pytest.mark.parametrize("overlap", [1, 2, 3])
def test_a_node_is_free_where_all_its_cells_are_within_the_overlap(closed: tuple[bool, bool], overlap: int) -> None:
    cells, owner = cells_of_grid(SHAPE, closed), owned()
    stands = originals_of(cells.nodes, cells.ties)
    corners = stands[cells.corners]
    for region in regions_of(cells, owner, overlap):
        near = owner == region.number
        for _ in range(overlap):
            near = np.isin(corners, corners[near]).any(axis=1)
        held = np.isin(stands, corners[~near])
        expected = cells.free * np.where(held, 0.0, 1.0)
        assert np.array_equal(region.cells.free, expected[:, region.nodes])
        every = np.flatnonzero(np.isin(corners, corners[near]).any(axis=1))
        assert np.array_equal(np.sort(cells_in_mesh(region, cells)), every)


@pytest.mark.parametrize("closed", CLOSED)
def test_all_second_differences_of_free_nodes_are_in_the_region(closed: tuple[bool, bool]) -> None:
    cells = cells_of_grid(SHAPE, closed)
    stands = originals_of(cells.nodes, cells.ties)
    for region in regions_of(cells, owned(), 2):
        there = {tuple(triple) for triple in stands[region.nodes[region.cells.triples]].tolist()}
        free = np.unique(stands[region.nodes[region.cells.free.any(axis=0)]])
        wanted = cells.triples[np.isin(cells.triples, free).any(axis=1)]
        assert {tuple(triple) for triple in wanted.tolist()} <= there


def test_copies_of_a_free_node_move_together() -> None:
    cells = cells_of_grid(SHAPE, (True, False))
    stands = originals_of(cells.nodes, cells.ties)
    region = regions_of(cells, owned(), 2)[0]
    copies, first = region.nodes[region.cells.ties].T
    assert copies.size > 0
    assert np.array_equal(stands[copies], stands[first])
    assert not np.isin(region.cells.triples, region.cells.ties[:, 0]).any()


def test_cuts_through_corners_keep_their_cells() -> None:
    cells = cells_of_grid(SHAPE)
    found = {}
    for region in regions_of(cells, owned(), 1):
        numbers = cells_in_mesh(region, cells)
        found |= {int(numbers[cell]): cut for cell, cut in region.cells.corner_cuts.items()}
    assert found == dict(cells.corner_cuts)


def test_the_sides_of_a_region_are_those_of_the_mesh_that_it_has() -> None:
    cells = cells_of_grid((9, 9))
    owner = em.Schwarz(subdomains=(2, 2)).owner_of_cells(em.Grid(n_xi=9, n_eta=9))
    sides = {frozenset(edge) for edge in cells.sides.tolist()}
    found = [{frozenset(edge) for edge in r.nodes[r.cells.sides].tolist()} for r in regions_of(cells, owner, 1)]
    assert set().union(*found) == sides
    assert all(0 < len(here) < len(sides) for here in found)


GRID = em.Grid(n_xi=25, n_eta=21)
WAVE = em.Expression("tanh(10*(y - 0.5 - 0.2*sin(2*pi*x)))")


def regions(columns: int = 3, rows: int = 2, closed: tuple[bool, bool] = (False, False)) -> tuple[Region, ...]:
    i, j = np.arange(GRID.n_xi - 1) * columns // GRID.n_xi, np.arange(GRID.n_eta - 1) * rows // GRID.n_eta
    return regions_of(cells_of_grid(GRID.shape, closed), (i[:, None] * rows + j).ravel(), 4)


def closed_objective() -> Objective:
    """The objective of a mesh whose lines along xi are closed."""
    weights = Weights(distortion=0.06, smoothness=0.1)
    cells = cells_of_grid(GRID.shape, (True, False))
    return Objective(WAVE, DomainChart(em.Rectangle()), cells, uniform(GRID), weights, Rule())


def meshes(found: Iterator[tuple[Array, Merged]]) -> list[tuple[Array, Merged]]:
    return list(found)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_an_exchange_is_worth_as_many_steps_of_the_whole_mesh(norm: Any) -> None:
    objective = objective_on(GRID, rule=Rule(norm=norm))
    whole = [now.value for _, now in descend(objective, uniform(GRID), 8, 0.0)]
    merged = meshes(RestrictedDescent(objective, regions()).descend(uniform(GRID), 3, 8, 0.0))
    values = [now.value for _, now in merged]
    assert values[0] - values[1] > 0.8 * (whole[0] - whole[-1])
    assert values == sorted(values, reverse=True)


def test_the_objective_and_the_error_are_those_of_the_whole_mesh() -> None:
    weights = Weights(distortion=0.03, smoothness=0.1, obliqueness=0.5, largest_cotangent=0.1)
    objective = objective_on(GRID, domain=em.AnnulusSector(), weights=weights, rule=Rule(cells="triangle"))
    mesh = bent(GRID, 3)
    objective.cut(mesh)
    here = objective.evaluate(mesh)
    _, now = next(RestrictedDescent(objective, regions()).descend(mesh, 1, 1, 0.0))
    assert now.value == pytest.approx(here.value, abs=1e-13)
    assert now.error == pytest.approx(here.error, rel=1e-13)
    assert now.distortion == pytest.approx(here.distortion, rel=1e-13)
    assert now.smallest_share == objective.smallest_share(mesh)


@pytest.mark.parametrize("is_closed", [False, True])
def test_the_mesh_does_not_depend_on_threads(is_closed: bool) -> None:
    found = []
    for threads in (1, 2):
        objective = closed_objective() if is_closed else objective_on(GRID)
        descent = RestrictedDescent(objective, regions(closed=(is_closed, False)), threads)
        found.append(meshes(descent.descend(uniform(GRID), 2, 4, 0.0))[-1][0])
    assert np.array_equal(*found)


def test_the_copies_of_tied_nodes_stay_a_period_apart() -> None:
    descent = RestrictedDescent(closed_objective(), regions(closed=(True, False)))
    mesh = meshes(descent.descend(uniform(GRID), 3, 8, 0.0))[-1][0].reshape(2, *GRID.shape)
    assert np.abs(mesh[0, -1] - mesh[0, 0] - 1.0).max() < 1e-14
    assert np.array_equal(mesh[1, -1], mesh[1, 0])
    assert np.abs(mesh[0, 0]).max() > 1e-3  # the line on which the grid is cut moves as others do


def test_a_merged_mesh_that_folds_is_drawn_back(monkeypatch: pytest.MonkeyPatch) -> None:
    def far(objective: Objective, mesh: Array, steps: int, min_decrease: float) -> Iterator[tuple[Array, Any]]:
        for moved, now in descend(objective, mesh, steps, min_decrease):
            yield mesh + 6.0 * (moved - mesh), now

    monkeypatch.setattr(restricted, "descend", far)
    objective = objective_on(GRID)
    found = meshes(RestrictedDescent(objective, regions()).descend(uniform(GRID), 2, 8, 0.0))
    assert len(found) > 1
    assert all(now.smallest_share > 0.0 for _, now in found)
    assert found[-1][1].value < found[0][1].value


def test_it_ends_where_exchanges_gain_little_and_where_u_is_met_exactly() -> None:
    descent = RestrictedDescent(objective_on(GRID), regions())
    assert len(meshes(descent.descend(uniform(GRID), 9, 8, 1.0))) == 2
    exact = RestrictedDescent(objective_on(GRID, em.Expression("1 + x - 2*y")), regions())
    assert meshes(exact.descend(uniform(GRID), 9, 8, 0.0)) == []


def test_derivatives_on_a_region_are_those_of_the_whole() -> None:
    weights = Weights(distortion=0.03, smoothness=0.1, obliqueness=0.5, largest_cotangent=0.1)
    for objective, closed in (
        (objective_on(GRID, RING, em.AnnulusSector(), weights=weights), False),
        (closed_objective(), True),
    ):
        mesh = uniform(GRID) + 0.02 * np.prod(np.sin(2.0 * np.pi * uniform(GRID)), axis=0)
        whole = objective.evaluate(mesh)
        assert whole is not None
        for region in regions(closed=(closed, False)):
            local = objective.on(region)
            start = np.ascontiguousarray(mesh[:, region.nodes])  # no loop is compiled for another order
            sums = local.sums(start, region.own_cells, region.own_triples)
            local.beyond = whole.error**2 - sums.every_square
            there = local.evaluate(start)
            moves = region.cells.free.copy()
            region.cells.tie(moves)
            alone = np.setdiff1d(np.flatnonzero(moves[0] * moves[1]), region.cells.ties)
            expected = whole.gradient[:, region.nodes[alone]]
            assert np.abs(there.gradient[:, alone] - expected).max() < 1e-11 * np.abs(whole.gradient).max()
