"""Values at nodes: integrals to rounding, bounds, and the order."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.transfer import transfer_nodal, transfer_spline
from solver.fields.bent_meshes import smooth_mesh
from solver.transfers.cases import fronts

WAVY = em.Expression("sin(3*x + y)*exp(y/2)")


def moved_values(old: em.Mesh, values: np.ndarray, new: em.Mesh) -> np.ndarray:
    return transfer_nodal(Overlaps.of(old, new), values, transfer_spline(old, {"u": values}, new)["u"])


def test_the_error_is_of_order_2() -> None:
    errors = []
    for n in (17, 33, 65):
        old, new = smooth_mesh(n), smooth_mesh(n, depth=0.03)
        moved = moved_values(old, WAVY.evaluate(old.x, old.y)[0], new)
        errors.append(np.abs(moved - WAVY.evaluate(new.x, new.y)[0]).max())
    assert np.log2(errors[1] / errors[2]) > 1.9
    assert errors[2] < 3e-4


def test_a_mesh_that_does_not_change_keeps_its_values() -> None:
    mesh, _ = fronts()
    values = np.random.default_rng(4).uniform(0.0, 1.0, mesh.x.shape)
    assert np.abs(moved_values(mesh, values, mesh) - values).max() < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_integral_and_bounds_hold_for_anything(seed: int) -> None:
    old, new = fronts()
    values = np.random.default_rng(seed).integers(0, 2, old.x.shape).astype(float)
    moved = moved_values(old, values, new)
    assert moved.min() >= 0.0
    assert moved.max() <= 1.0
    assert em.integral(new, moved) == pytest.approx(em.integral(old, values), rel=1e-14)


def test_the_integral_is_kept_by_the_parts_and_not_only_by_sharing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.transfers.transfer.share_out", lambda *_: None)
    old, new = fronts()
    values = WAVY.evaluate(old.x, old.y)[0]
    assert em.integral(new, moved_values(old, values, new)) == pytest.approx(em.integral(old, values), rel=1e-13)
