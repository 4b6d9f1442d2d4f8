"""Levels: from a coarse grid, or coarse blocks, to the requested mesh, with nodes that stay on their curves."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from block_cases import changed
from equimesh.blocks.blocks import Blocks
from equimesh.least_error import block_mesh
from equimesh.least_error.block_levels import BlockLevel, block_levels, edges_of
from equimesh.least_error.block_mesh import Bilinear, BlockMesh, Place
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Nodes, smallest_share
from equimesh.least_error.lifting import Lifting
from equimesh.least_error.nest import COARSEST_CELLS, coarse_level, nested_levels
from equimesh.least_error.paved import is_paved
from equimesh.meshes.cell_edges import quads_of_block
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.testing.geometries import disc, l_shape, naca0012_c, naca0012_o, pitz_daily, ring

SHAPES = [(65, 65), (129, 65), (40, 171), (4, 4), (5, 300), (9, 9), (17, 16), (300, 5), (1025, 1025)]


def shapes(n_xi: int, n_eta: int) -> list[tuple[int, int]]:
    return [level.grid.shape for level in nested_levels(em.Grid(n_xi=n_xi, n_eta=n_eta))]


def test_square_grids_are_halved() -> None:
    assert shapes(65, 65) == [(9, 9), (17, 17), (33, 33), (65, 65)]
    assert shapes(4, 4) == [(4, 4)]
    assert shapes(9, 9) == [(9, 9)]


def test_grids_that_are_not_square_begin_square() -> None:
    assert shapes(129, 65) == [(9, 9), (17, 17), (33, 33), (65, 65), (129, 65)]
    assert shapes(40, 171) == [(11, 12), (21, 22), (40, 43), (40, 86), (40, 171)]
    assert shapes(5, 300) == [(5, 10), (5, 20), (5, 38), (5, 76), (5, 151), (5, 300)]


@pytest.mark.parametrize("shape", SHAPES)
def test_levels_grow_to_the_grid_at_most_twofold(shape: tuple[int, int]) -> None:
    levels = nested_levels(em.Grid(n_xi=shape[0], n_eta=shape[1]))
    assert levels[-1].grid.shape == shape
    assert [level.is_finest for level in levels] == [False] * (len(levels) - 1) + [True]
    assert [level.number for level in levels] == list(range(len(levels)))
    assert {level.count for level in levels} == {len(levels)}
    assert max(levels[0].grid.shape) <= max(COARSEST_CELLS * 1.5 + 1, 4)
    for coarse, fine in itertools.pairwise(levels):
        for n, m in zip(coarse.grid.shape, fine.grid.shape, strict=True):
            assert n - 1 <= m - 1 <= 2 * (n - 1) + 1
        assert fine.grid.points > coarse.grid.points
        assert fine.steps <= coarse.steps
        assert fine.gauss_points <= coarse.gauss_points
    assert all(level.steps > 0 and level.gauss_points >= 2 for level in levels)


# Of blocks: nodes of a coarse mesh are nodes of the finest one, and edges have one set of nodes.

MAKERS = [l_shape, disc, ring, naca0012_c, pitz_daily]


@pytest.mark.parametrize("make", MAKERS)
def test_every_level_is_a_valid_mesh_of_nodes_of_the_finest(make: Callable[[int], Blocks]) -> None:
    mesh = make(2500).mesh
    levels = block_levels(mesh)
    assert len(levels) > 1
    assert [level.number for level in levels] == list(range(len(levels)))
    assert {level.count for level in levels} == {len(levels)}
    assert np.array_equal(levels[-1].nodes, np.arange(len(mesh.points)))
    for coarse, fine in itertools.pairwise(levels):
        assert coarse.points < 0.6 * fine.points
    for level in levels:
        here = mesh.points[level.nodes]
        assert set(level.cells.ravel().tolist()) == set(range(level.points))
        for block, (rows, columns), nodes in zip(mesh.blocks, level.lines, level.blocks, strict=True):
            assert np.array_equal(level.nodes[nodes], block[np.ix_(rows, columns)])
        corners = here[np.concatenate([quads_of_block(block) for block in level.blocks])]
        one, other = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
        assert (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0.0).all()


@pytest.mark.parametrize("make", MAKERS)
def test_an_edge_is_found_from_the_block_on_its_other_side(make: Callable[[int], Blocks]) -> None:
    mesh = make(600).mesh
    edges, shared = edges_of(mesh), 0
    for block, nodes in enumerate(mesh.blocks):
        for axis, end in np.ndindex(2, 2):
            other = edges.across(block, axis, end)
            if other is None:
                continue
            shared += 1
            along = nodes[-end] if axis == 0 else nodes[:, -end]
            there = mesh.blocks[other.block]
            row = there[-other.end] if other.axis == 0 else there[:, -other.end]
            assert np.array_equal(row[::-1] if other.is_turned else row, along)
            back = edges.across(other.block, other.axis, other.end)
            assert (back.block, back.axis, back.end, back.is_turned) == (block, axis, end, other.is_turned)
    assert shared > 0


def test_steps_and_gauss_points_fall_with_the_points() -> None:
    levels = block_levels(l_shape(20_000).mesh)
    assert [level.steps for level in levels] == sorted((level.steps for level in levels), reverse=True)
    assert [level.gauss_points for level in levels] == sorted((level.gauss_points for level in levels), reverse=True)
    assert [level.is_finest for level in levels] == [False] * (len(levels) - 1) + [True]


def last_levels(domain: Blocks) -> tuple[BlockLevel, BlockLevel]:
    coarse, fine = block_levels(domain.mesh)[-2:]
    return coarse, fine


@pytest.mark.parametrize(("cubic", "degree"), [(True, 3), (False, 1)])
def test_polynomials_of_a_grid_of_equal_cells_are_lifted_exactly(cubic: bool, degree: int) -> None:
    domain = l_shape(1500)
    coarse, fine = last_levels(domain)
    x, y = domain.mesh.points.T
    values = np.stack([x**degree - 2.0 * y**degree, 1.0 + x * y])
    lifted = Lifting(coarse, fine).lifted(values[:, coarse.nodes], cubic=cubic)
    assert lifted == pytest.approx(values, abs=1e-13)


@pytest.mark.parametrize("make", [disc, ring, l_shape])
@pytest.mark.parametrize("cubic", [True, False])
def test_nodes_of_both_levels_keep_their_values(make, cubic: bool) -> None:  # type: ignore[no-untyped-def]
    coarse, fine = last_levels(make(1500))
    values = np.random.default_rng(1).normal(size=(2, coarse.points))
    lifting = Lifting(coarse, fine)
    lifted = lifting.lifted(values, cubic=cubic)
    assert np.array_equal(lifted[:, np.searchsorted(fine.nodes, coarse.nodes)], values)
    along = lifting.lifted_along_sides(values[0], cubic=cubic)
    edge = coarse.blocks[0][-1]
    assert np.array_equal(along[np.searchsorted(fine.nodes, coarse.nodes[edge])], values[0, edge])


def test_a_bilinear_map_and_its_derivatives_are_exact_at_all_places() -> None:
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 7), indexing="ij")
    block = Bilinear(np.stack([2.0 * s + t, 3.0 * s * t], axis=-1))
    s, t = np.array([[0.0, 0.3, 1.0]]), np.array([[1.0, 0.21, 0.0]])
    exact = 2.0 * s + t, 3.0 * s * t, 2.0 + 0.0 * s, 1.0 + 0.0 * s, 3.0 * t, 3.0 * s
    assert np.array(block.places(s, t)) == pytest.approx(np.array(exact), abs=1e-14)


def test_a_closed_line_is_smooth_where_it_is_cut() -> None:
    domain = ring(3000)
    coarse, fine = last_levels(domain)
    angle = np.arctan2(domain.mesh.y, domain.mesh.x)
    values = np.stack([np.cos(angle), np.sin(angle)])
    lifted = Lifting(coarse, fine).lifted(values[:, coarse.nodes], cubic=True)
    errors = np.abs(lifted - values).max(axis=0)
    first = domain.mesh.blocks[0]
    at_cut = errors[first[:, :2]].max(), errors[first[:, -2:]].max()
    assert max(at_cut) <= 1.001 * errors.max()
    assert errors.max() < 1e-4
    assert max(at_cut) == pytest.approx(min(at_cut), rel=1e-6, abs=1e-12)


FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")


def solved(domain: Blocks, u: em.Expression = FRONT, start: Mesh | None = None, threads: int = 1) -> list[Descent]:
    return list(LeastErrorSolve(monitor=em.LeastError(u=u).on(domain), domain=domain, threads=threads).steps(start))


def test_records_go_up_the_levels_with_falling_errors() -> None:
    domain = l_shape(1200)
    records = solved(domain)
    assert {record.start for record in records} == {"initial", "rectilinear"}
    assert all(one.level <= other.level for one, other in pairwise(records) if one.start == other.start)
    last = [record for record in records if record.level == records[-1].level]
    assert last[-1].level == last[-1].levels - 1
    assert last[-1].gain > 3.0
    assert last[-1].error <= last[0].error
    assert last[-1].points == domain.points
    assert last[-1].grid is None
    assert last[-1].numbers()["points"] == domain.points
    assert "grid" not in last[-1].numbers()


@pytest.mark.parametrize("make", [l_shape, ring, naca0012_o])
def test_nodes_of_the_boundary_stay_on_it_and_corners_stay(make) -> None:  # type: ignore[no-untyped-def]
    domain = make(1000)
    mesh = solved(domain)[-1].mesh
    assert not mesh.is_grid
    assert not mesh.is_folded
    fixed = domain.node_curve == -2
    assert np.array_equal(mesh.points[fixed], domain.mesh.points[fixed])
    for number, curve in enumerate(domain.curves):
        x, y = mesh.points[domain.node_curve == number].T
        if x.size:
            at = curve.evaluate(curve.nearest(x, y))
            assert np.hypot(at[0] - x, at[1] - y).max() < 1e-7
    assert np.abs(mesh.points - domain.mesh.points).max() > 0.01


def test_threads_do_not_change_a_bit() -> None:
    domain = l_shape(4500)
    one, two = (solved(domain, threads=threads)[-1].mesh for threads in (1, 2))
    assert np.array_equal(one.x, two.x)
    assert np.array_equal(one.y, two.y)


def test_a_given_mesh_is_taken_where_it_is_better() -> None:
    domain = l_shape(1200)
    before = solved(domain)[-1]
    assert not before.mesh.is_grid
    records = solved(domain, em.Expression("tanh(12*((x + 0.21)**2 + (y - 0.1)**2 - 0.5))"), before.mesh)
    assert {record.start for record in records} == {"given"}
    assert before.gain is not None
    assert records[-1].gain > 0.9 * before.gain


def test_a_function_that_is_interpolated_exactly_keeps_the_initial_mesh() -> None:
    domain = l_shape(600)
    mesh = solved(domain, em.Expression("2*x - y"))[-1].mesh
    assert not mesh.is_grid
    assert mesh.distance(domain.mesh) < 1e-14


def test_comparing_ends_below_the_finest_mesh() -> None:
    domain = l_shape(2500)
    solve = LeastErrorSolve(monitor=em.LeastError(u=FRONT).on(domain), domain=domain)
    steps = solve.coarse(coarse_level(solve.levels))
    while True:
        try:
            next(steps)
        except StopIteration as end:
            reached = end.value
            break
    assert reached.record.level == reached.record.levels - 2
    lifted = solve.lifted_error(reached)
    records = list(solve.steps(coarse=reached))
    assert {record.level for record in records} == {reached.record.level + 1}
    # The descent begins there; it may measure with more Gauss points.
    assert records[0].error == pytest.approx(lifted, rel=0.15)


@dataclass
class Judged:
    """In place of an objective: how valid meshes are, and their errors."""

    smallest_share: Callable[[Array], float]
    error: Callable[[Array], float] = lambda _: 0.0

    def held(self, mesh: Array) -> Array:
        return mesh


def moved(mesh: BlockMesh, share: float, seed: int = 1) -> Place:
    moves = np.random.default_rng(seed).uniform(-share, share, mesh.first.unknowns.shape) * mesh.chart.free
    mesh.cells.tie(moves)
    return Place(mesh=mesh, unknowns=mesh.first.unknowns + moves)


def test_the_first_mesh_is_the_initial_one() -> None:
    domain = disc(1500)
    for level in block_levels(domain.mesh):
        first = BlockMesh.of(domain, level).first
        assert np.abs(first.points.T - domain.mesh.points[level.nodes]).max() < 1e-13


def test_nodes_slide_on_their_curve_and_are_lifted_on_it() -> None:
    domain = disc(1500)
    coarse, fine = (BlockMesh.of(domain, level) for level in block_levels(domain.mesh)[-2:])
    place = moved(coarse, 0.01)
    lifted = place.lifted(coarse.first, fine.first, Judged(lambda _: 1.0))
    for here in (place, lifted):
        on_circle = domain.node_curve[here.mesh.level.nodes] >= 0
        assert np.hypot(*here.points[:, on_circle]) == pytest.approx(1.0, abs=1e-13)
    both = np.searchsorted(fine.level.nodes, coarse.level.nodes)
    assert lifted.points[:, both] == pytest.approx(place.points, abs=1e-13)
    assert not np.allclose(place.points, coarse.first.points, atol=1e-3)


def test_a_mesh_whose_positions_fold_is_replaced_by_the_initial_one() -> None:
    domain = disc(1500)
    coarse, fine = (BlockMesh.of(domain, level) for level in block_levels(domain.mesh)[-2:])
    assert moved(coarse, 0.01).lifted(coarse.first, fine.first, Judged(lambda _: -1.0)) is fine.first


def test_points_are_taken_over_with_their_nearest_places_on_closed_curves() -> None:
    domain = ring(800)
    mesh = BlockMesh.of(domain, block_levels(domain.mesh)[-1])
    place = moved(mesh, 0.02)
    again = mesh.of_points(np.ascontiguousarray(place.points.T))
    assert again.points == pytest.approx(place.points, abs=1e-12)
    assert again.unknowns == pytest.approx(place.unknowns, abs=1e-9)


def test_meshes_of_levels_have_their_cells_and_the_finest_its_sides() -> None:
    domain = disc(800)
    levels = block_levels(domain.mesh)
    coarse, fine = (BlockMesh.of(domain, level).first.quad_mesh for level in (levels[0], levels[-1]))
    assert np.array_equal(coarse.cells, levels[0].cells)
    assert not coarse.is_folded
    assert fine.sides.keys() == domain.mesh.sides.keys()


def test_displacements_that_fold_are_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rest of the mesh is that of the cubic interpolation, and not the initial one."""
    domain = disc(1500)
    coarse, fine = (BlockMesh.of(domain, level) for level in block_levels(domain.mesh)[-2:])
    place = moved(coarse, 0.03)

    def share(unknowns: Array) -> float:
        first, corners = fine.first.unknowns, fine.cells.corners.reshape(-1)
        return float(smallest_share(*(Nodes(*fine.chart.nodes(one), corners) for one in (unknowns, first))))

    moves = Lifting(coarse.level, fine.level).lifted(place.points - coarse.first.points, cubic=True)
    cubic = fine.first.points + moves
    inside = domain.node_curve == -1
    assert share(np.where(inside, cubic, fine.first.unknowns)) < 0.0
    errors: list[Array] = []

    def error(unknowns: Array) -> float:
        errors.append(unknowns)
        return float(len(errors))

    lifted = place.lifted(coarse.first, fine.first, Judged(share, error))
    assert share(lifted.unknowns) > 0.0
    kept = inside & (np.abs(lifted.points - cubic).max(axis=0) < 1e-13)
    assert 0.5 < kept.sum() / inside.sum() < 1.0
    # The others are worse here, and are taken where they are better.
    assert len(errors) > 1
    assert all(share(one) > 0.0 for one in errors)
    last = errors[-1]
    assert np.array_equal(
        place.lifted(
            coarse.first, fine.first, Judged(share, lambda one: float(not np.array_equal(one, last)))
        ).unknowns,
        last,
    )
    # On a fine mesh the first that does not fold is taken, without errors.
    compared = list(errors)
    monkeypatch.setattr(block_mesh, "MAX_TRIED_POINTS", 1000)
    taken = place.lifted(coarse.first, fine.first, Judged(share, error))
    assert np.array_equal(taken.unknowns, compared[0])
    assert len(errors) == len(compared) > 1


def paved() -> Blocks:
    """A disc whose blocks are single cells, as those of a mesh without any structure."""
    source = disc(700).mesh
    mesh = Blocks.of_mesh(source.points, source.cells, {}, corner_angle=80)
    cells = tuple(cell[[[0, 3], [1, 2]]] for cell in source.cells)
    object.__setattr__(mesh, "mesh", changed(mesh.mesh, blocks=cells, block_names=()))
    return mesh


def test_blocks_of_single_cells_are_paved_and_structured_ones_are_not() -> None:
    assert is_paved(paved().mesh)
    assert not is_paved(disc(700).mesh)
    assert not is_paved(l_shape(700).mesh)


def test_a_paved_disc_gains_without_coarser_meshes_and_stays_round() -> None:
    domain = paved()
    front = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
    solution = em.solve(em.Problem(monitor=em.LeastError(u=front), domain=domain))
    assert not solution.mesh.is_folded
    assert solution.interpolation.estimated_gain("l2") > 3.0
    on = domain.node_curve >= 0
    assert on.any()
    assert np.abs(np.hypot(*solution.mesh.points[on].T) - 1.0).max() < 1e-12
    assert {record["level"] for record in solution.descent} == {0}
    errors = [record["error"] for record in solution.descent]
    assert errors[-1] < errors[0]
