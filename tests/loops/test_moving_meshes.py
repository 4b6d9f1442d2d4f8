"""Loops of the examples on moving meshes: integrals, bounds and places of fronts after many steps."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str) -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLES / name))


def check_disc(steps: int, n: int) -> tuple[float, float]:
    """Mass and bounds of the disc; its L1 error on moving meshes and on the uniform one."""
    disc = example("18_rotating_disc.py")
    states, (*_, fixed) = list(disc["run"](steps, n)), disc["run"](steps, n, adapts=False)
    masses = [em.integral(mesh, q, "cells") for mesh, q in states]
    assert np.ptp(masses) < 1e-12 * masses[0]
    for _, q in states:
        assert q.min() > -1e-12
        assert q.max() < 1.0 + 1e-12
    return disc["l1_error"](*states[-1], steps), disc["l1_error"](*fixed, steps)


def check_shock(steps: int, n: int) -> tuple[float, float]:
    """Mass, bounds and place of the shock; its L1 error on moving meshes and on the uniform one."""
    shock = example("19_burgers_shock.py")
    states, (*_, fixed) = list(shock["run"](steps, n)), shock["run"](steps, n, adapts=False)
    entered = 0.5 * shock["STEP"] * np.arange(steps + 1)
    masses = np.array([em.integral(mesh, q, "cells") for mesh, q in states]) - entered
    assert np.ptp(masses) < 1e-12
    for _, q in states:
        assert q.min() >= -1e-12
        assert q.max() <= 1.0 + 1e-12
    assert masses[-1] == pytest.approx(0.25, abs=2e-4)  # the mean place of the shock, at the speed 1/2
    return shock["l1_error"](*states[-1], steps), shock["l1_error"](*fixed, steps)


def test_a_rotating_disc_keeps_its_mass_and_bounds() -> None:
    moving, uniform = check_disc(2, 25)
    assert moving < 0.8 * uniform


@pytest.mark.everything  # 50 steps
def test_a_disc_that_has_rotated_once_has_less_than_half_the_error_of_the_uniform_mesh() -> None:
    moving, uniform = check_disc(50, 33)
    assert moving < 0.5 * uniform


def test_a_shock_keeps_its_mass_bounds_and_place() -> None:
    moving, uniform = check_shock(3, 17)
    assert moving < 0.7 * uniform


@pytest.mark.everything  # 20 steps
def test_a_shock_of_burgers_equation_stays_sharp_at_the_right_place() -> None:
    moving, uniform = check_shock(20, 33)
    assert moving < 0.25 * uniform


def radius_after(steps: int, transfer: str | None, n: int) -> tuple[float, float]:
    """The radius of the circle after some steps, and that of theory."""
    circle = example("20_allen_cahn.py")
    *_, (mesh, u) = circle["run"](steps, transfer, n)
    assert np.abs(u).max() < 1.0 + 1e-3  # elements with a consistent mass matrix overshoot by themselves
    return circle["radius"](mesh, u), float(np.sqrt(circle["RADIUS"] ** 2 - 2 * circle["DT"] * steps))


def test_a_circle_begins_to_shrink_at_the_speed_of_theory() -> None:
    pytest.importorskip("skfem")
    moving, exact = radius_after(10, "conservative", 25)
    assert moving == pytest.approx(exact, abs=1e-3)


@pytest.mark.everything  # 500 steps
@pytest.mark.parametrize("transfer", ["spline", "conservative"])
def test_a_circle_shrinks_over_500_steps_as_theory_says(transfer: str) -> None:
    pytest.importorskip("skfem")
    moving, exact = radius_after(500, transfer, 33)
    uniform, _ = radius_after(500, None, 33)
    assert moving == pytest.approx(exact, abs=1e-3)
    assert abs(uniform - exact) > 20 * abs(moving - exact)  # on the uniform mesh the front is almost still
