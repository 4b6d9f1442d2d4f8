# ruff: noqa: ARG005 - what a broken condition is given does not matter
"""The kit of transmission conditions: the project's own pass it, and it refuses each broken promise."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import equimesh as em
from equimesh.equations.mesh_equations import NodalState
from equimesh.schwarz.conditions import Functional
from equimesh.testing import check_transmission, checks


@pytest.mark.parametrize(
    "condition",
    [em.Classical(), em.LinearRobin(p=2.0), em.NonlinearRobin(), em.Optimized(), em.Optimized(data=em.LineData.LOCAL)],
    ids=str,
)
def test_own_conditions_pass(condition: em.TransmissionCondition) -> None:
    check_transmission(condition)


@dataclass(frozen=True, kw_only=True)
class WrongDerivative(em.LinearRobin):
    def normal(self, window: NodalState, i: int, p: float) -> Functional:
        right = super().normal(window, i, p)
        return Functional(right.values, tuple((unknown, 1.001 * by) for unknown, by in right.derivatives))


@dataclass(frozen=True, kw_only=True)
class Partial(em.LinearRobin):
    """Compares what is not comparable: its value depends on the window that it is read in."""

    def tangential(self, window: NodalState, i: int, p: float) -> Functional:
        right = super().tangential(window, i, p)
        return Functional(right.values + 1e-3 * i, right.derivatives)


@dataclass(frozen=True, kw_only=True)
class WrongSign(em.LinearRobin):
    def normal(self, window: NodalState, i: int, p: float) -> Functional:
        return super().normal(window, i, -p)

    def tangential(self, window: NodalState, i: int, p: float) -> Functional:
        return super().tangential(window, i, -p)


@dataclass(frozen=True, kw_only=True)
class Infinite(em.LinearRobin):
    def strength(self, distance: float) -> float:  # noqa: ARG002
        return np.inf


@pytest.mark.parametrize(
    ("condition", "sentence"),
    [
        (SimpleNamespace(name="mine"), "name must be a string, and ghosts the number of grid lines"),
        (SimpleNamespace(name="mine", ghosts=1, strength=lambda distance: 1.0), "Schwarz does not take the condition"),
        (Infinite(), r"strength\(0.1\) = inf"),
        (WrongDerivative(), "the derivative of the equation of x at node .* in subdomain 0 is wrong by"),
        (Partial(), "subdomain 0 does not keep the single-domain mesh: .* has the residual"),
        (WrongSign(), "with 2 x 1 subdomains, an overlap of 4 and parallel ordering, classical data took the place"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_broken_promises_are_refused(condition: em.TransmissionCondition, sentence: str) -> None:
    with pytest.raises(AssertionError, match=sentence):
        check_transmission(condition)


def test_a_condition_that_does_not_converge_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "MAX_ITERATIONS", 9)
    with pytest.raises(AssertionError, match="does not converge: after 9 iterations the mesh still moves by"):
        check_transmission(em.Classical())


def test_a_limit_that_is_another_mesh_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "LIMIT", 1e-17)
    monkeypatch.setattr(em.Iteration, "meets", lambda record, tolerance: record.change < 1e-3)  # stops early
    with pytest.raises(AssertionError, match="the limit differs from the single-domain mesh by"):
        check_transmission(em.Classical())
