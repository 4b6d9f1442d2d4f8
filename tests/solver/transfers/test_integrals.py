"""The integrals that are kept."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import SamplesError
from equimesh.transfers.integrals import Cells, measures_of, total, untied
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.transfer import transfer_averages
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import disc, strip
from solver.transfers.cases import averages, fronts


def test_the_integral_of_nodal_values_is_that_of_the_bilinear_function() -> None:
    skfem = pytest.importorskip("skfem")
    mesh = smooth_mesh(9)
    values = np.random.default_rng(3).uniform(-1.0, 1.0, mesh.x.shape)
    basis = skfem.Basis(skfem.MeshQuad(mesh.points.T, mesh.cells.T), skfem.ElementQuad1())
    exact = skfem.Functional(lambda w: w["u"]).assemble(basis, u=basis.interpolate(values.reshape(-1)))
    assert em.integral(mesh, values) == pytest.approx(float(exact), abs=1e-14)


def test_areas_and_centroids_are_exact() -> None:
    cells = Cells.of(smooth_mesh(9))
    for values, function in ((cells.x, lambda x, y: x + 0 * y), (cells.y, lambda x, y: y + 0 * x)):
        assert np.abs(values - averages(smooth_mesh(9), function).reshape(-1)).max() < 1e-15
    assert total(cells.area, np.ones(cells.area.size)) == pytest.approx(1.0, abs=1e-15)
    assert cells.node_weights.sum() == pytest.approx(1.0, abs=1e-14)
    assert np.all(cells.weights > 0.0)
    nodal = np.arange(9 * 12, dtype=float)
    assert cells.at_corners(nodal)[0].tolist() == [0.0, 12.0, 13.0, 1.0]


def test_values_of_another_shape_are_refused() -> None:
    assert em.integral(smooth_mesh(9), np.ones((8, 11)), "cells") == pytest.approx(1.0)
    with pytest.raises(SamplesError, match=r"\(9, 12\) is needed for nodes"):
        em.integral(smooth_mesh(9), np.ones((8, 11)))


# Averages over cells: integrals to rounding, bounds, and the order.


def wave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sin(3.0 * x + y) * np.exp(0.5 * y)


def test_the_error_is_of_order_2() -> None:
    errors = []
    for n in (17, 33, 65):
        overlaps = Overlaps.of(smooth_mesh(n), smooth_mesh(n, depth=0.03))
        moved = transfer_averages(overlaps, averages(smooth_mesh(n), wave).reshape(-1))
        error = moved - averages(smooth_mesh(n, depth=0.03), wave).reshape(-1)
        errors.append([total(overlaps.new.area, np.abs(error)), np.sqrt(total(overlaps.new.area, error**2))])
    assert np.all(np.log2(np.array(errors[1]) / errors[2]) > 2.0), errors
    assert errors[2][0] < 3e-5


@pytest.mark.parametrize("seed", range(3))
def test_integral_and_bounds_hold_for_anything(seed: int) -> None:
    rng, (old, new) = np.random.default_rng(seed), fronts()
    overlaps = Overlaps.of(old, new)
    values = rng.integers(0, 2, overlaps.old.area.size).astype(float) + rng.uniform(1e3, 1e4)
    moved = transfer_averages(overlaps, values)
    assert moved.min() >= values.min()
    assert moved.max() <= values.max()
    assert total(overlaps.new.area, moved) == pytest.approx(total(overlaps.old.area, values), rel=1e-14)


def test_the_integral_is_kept_by_the_parts_and_not_only_by_sharing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.transfers.transfer.share_out", lambda *_: None)
    overlaps = Overlaps.of(*fronts())
    values = np.random.default_rng(9).uniform(0.0, 1.0, overlaps.old.area.size)
    moved = transfer_averages(overlaps, values)
    assert total(overlaps.new.area, moved) == pytest.approx(total(overlaps.old.area, values), rel=1e-13)


def test_given_bounds_leave_room_at_the_sides() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    new = em.Mesh(uniform.x**2, uniform.y)  # its first column is thinner
    overlaps = Overlaps.of(uniform, new)
    exact = Cells.of(new).x
    assert np.abs(transfer_averages(overlaps, overlaps.old.x, (0.0, 1.0)) - exact).max() < 1e-14
    assert np.abs(transfer_averages(overlaps, overlaps.old.x) - exact).max() > 0.01


# Areas, centroids and weights of corners.


def test_a_trapezium() -> None:
    found = measures_of(np.array([[[0.0, 2.0, 1.0, 0.0]], [[0.0, 0.0, 1.0, 1.0]]]))
    assert found.area[0] == 1.5
    assert (found.x[0], found.y[0]) == (pytest.approx(7 / 9), pytest.approx(4 / 9))
    assert found.weights.sum() == pytest.approx(1.5)
    # The integral of a linear function by its corners is that of the centroid.
    assert found.weights[0] @ [0.0, 2.0, 1.0, 0.0] == pytest.approx(1.5 * 7 / 9)
    assert found.weights[0] @ [0.0, 0.0, 1.0, 1.0] == pytest.approx(1.5 * 4 / 9)


# Sums at the nodes and corners of blocks, with tied nodes as one.


def test_sums_and_extremes_around_nodes() -> None:
    grid = smooth_mesh(7)
    cells, nodal = Cells.of(grid), np.sin(grid.x).reshape(-1)
    assert np.array_equal(cells.at_corners(nodal), nodal[grid.cells])
    assert np.abs(cells.at_nodes(np.ones((len(grid.cells), 4))).reshape(grid.node_shape)[1:-1, 1:-1] - 4.0).max() == 0.0
    area = cells.area.reshape(grid.cell_shape)
    for extreme in (np.minimum, np.maximum):
        found = cells.around_nodes(cells.area, extreme).reshape(grid.node_shape)
        assert found[2, 3] == extreme.reduce(area[1:3, 2:4].ravel())
    assert (cells.shape, cells.nodes) == ((len(grid.cells),), (nodal.size,))


def test_tied_nodes_are_one_node() -> None:
    mesh = strip(4)
    cells = Cells.of(mesh)
    assert cells.nodes == (20,)
    assert cells.node_weights.sum() == pytest.approx(1.0)
    assert np.allclose(cells.node_weights.reshape(4, 5)[:, 2], 1 / 16)
    assert np.all(cells.links.neighbours.reshape(4, 4, 4)[:, 1:-1] >= 0)
    assert untied(disc(2))[0].size == len(disc(2).points)


def test_a_copy_of_a_copy_is_the_same_node() -> None:
    mesh = strip(3, both=True)
    kept, number = untied(mesh)
    assert kept.size == 9
    assert number[[0, 3, 12, 15]].tolist() == [0, 0, 0, 0]
