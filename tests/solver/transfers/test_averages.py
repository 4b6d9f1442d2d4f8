"""Averages over cells: integrals to rounding, bounds, and the order."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.transfers.integrals import cells_of, total
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.transfer import transfer_averages
from solver.fields.bent_meshes import smooth_mesh
from solver.transfers.cases import averages, fronts


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
    exact = cells_of(new).x
    assert np.abs(transfer_averages(overlaps, overlaps.old.x, (0.0, 1.0)) - exact).max() < 1e-14
    assert np.abs(transfer_averages(overlaps, overlaps.old.x) - exact).max() > 0.01
