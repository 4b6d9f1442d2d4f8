"""Points all over a domain: what they stand for, and what is named where a function is not finite."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.monitors import monitor as probe_module
from equimesh.monitors.monitor import Probe, bound_copy, is_bound_to
from equimesh.testing.geometries import disc
from solver.monitors.metrics import SECTOR, STEEP, UNIT


def test_shares_are_those_of_the_area() -> None:
    """The mean of x over a quarter of an annulus is (8 - 1) / 3 over its area 3 pi / 4."""
    probe = Probe.of(em.AnnulusSector())
    assert probe.x.shape == probe.shares.shape == (256 * 256,)
    assert probe.shares.sum() == pytest.approx(1.0)
    assert (probe.shares * probe.x).sum() == pytest.approx(7 / 3 / (3 * np.pi / 4), rel=1e-4)
    assert probe.diameter == 2.0


def test_cells_of_blocks_are_probed_evenly_where_they_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = disc(800)
    every = Probe.of(domain)
    monkeypatch.setattr(probe_module, "MAX_CELLS", 144)
    some = Probe.of(domain)
    assert every.x.size == len(domain.mesh.cells)
    assert len(domain.mesh.cells) / 144 > 5
    assert 100 < some.x.size <= 144
    for probe in (every, some):
        assert probe.shares.sum() == pytest.approx(1.0)
        # The mean of the squared distance from the centre of the unit disc is 1/2.
        assert (probe.shares * (probe.x**2 + probe.y**2)).sum() == pytest.approx(0.5, abs=0.03)


def test_the_closure_holds_the_corners() -> None:
    probe = Probe.of_closure(em.Rectangle(x=(2, 5), y=(-1, 1)), cells=4)
    assert {*zip(probe.x, probe.y, strict=True)} >= {(2, -1), (2, 1), (5, -1), (5, 1)}
    assert probe.shares == pytest.approx(np.full(25, 1 / 25))
    assert probe.diameter == 3.0
    inner = Probe.of(em.Rectangle(x=(2, 5), y=(-1, 1)), cells=4)
    assert (inner.x.min(), inner.y.max()) == (2.375, 0.75)


def test_the_first_point_that_is_not_finite_is_named() -> None:
    probe = Probe.of_closure(UNIT, cells=2)
    fine, bad = np.ones(9), np.ones(9)
    probe.require_finite([fine, bad], "u is", field="u")
    bad[5] = np.nan
    fine[7] = np.inf
    with pytest.raises(em.InputError, match=r"u is not finite at \(x, y\) = \(0\.5, 1\)") as caught:
        probe.require_finite([fine, bad], "u is", field="rho")
    assert caught.value.field == "rho"


def test_a_bound_copy_remembers_its_domain() -> None:
    monitor = em.Curvature(u=STEEP)
    copy = bound_copy(monitor, SECTOR, alpha=3.0)
    assert (copy.alpha, monitor.alpha) == (3.0, None)
    assert is_bound_to(copy._domain, SECTOR)
    assert is_bound_to(em.Rectangle(), UNIT)
    assert not is_bound_to(None, UNIT)
    assert not is_bound_to(copy._domain, UNIT)
