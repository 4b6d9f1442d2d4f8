"""A level of a domain in blocks: nodes stay on their curves, wherever the mesh is taken from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh, Place
from equimesh.least_error.kernels import Nodes, smallest_share
from equimesh.least_error.lifting import Lifting
from equimesh.numerics.types import Array
from equimesh.testing.geometries import disc, ring


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
    coarse, fine = (BlockMesh.of(domain, level).first.quad_mesh(domain.mesh) for level in (levels[0], levels[-1]))
    assert np.array_equal(coarse.cells, levels[0].cells)
    assert not coarse.is_folded
    assert fine.sides.keys() == domain.mesh.sides.keys()


def test_displacements_that_fold_are_mended() -> None:
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
