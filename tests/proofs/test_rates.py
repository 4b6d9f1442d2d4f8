"""Predicted rates, against exact Schwarz iterations for one-dimensional meshes of a given density.

With ``x = G(t)``, t the share of metric length, the density is ``m = 1 / G'(t)``, and the mesh of a subdomain is one of
equally spaced t: its solves are exact, with two unknowns, and nothing is left out but what makes the problem nonlinear.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.decomposition import Decomposition, turns
from equimesh.schwarz.rates import predicted_rate, steps_to_exact

Array = npt.NDArray[np.float64]
POINTS = 33


@dataclass(frozen=True)
class Density:
    """``x = G(t)`` and its slope, the reciprocal density."""

    positions: Callable[[Array], Array]
    slope: Callable[[float], float]


# One that varies everywhere, by a factor of 3; and one with a layer on the left, and equal to 2 from t = 1/4 on.
BENT = Density(lambda t: t - np.sin(2 * np.pi * t) / (4 * np.pi), lambda t: 1 - math.cos(2 * math.pi * t) / 2)
LAYERED = Density(
    lambda t: 0.5 * t + 32 * (1 / 64 - np.maximum(0.25 - t, 0.0) ** 3), lambda t: 0.5 + 96 * max(0.25 - t, 0.0) ** 2
)


@dataclass(frozen=True)
class Line:
    """A Schwarz iteration for the equidistributing mesh of one line; states are t at the ends of the whole line, to
    which those of a subdomain extrapolate."""

    density: Density
    parts: Decomposition
    settings: em.Schwarz

    def rate(self, iterations: int) -> float:
        """The factor by which the error falls over the last four of some iterations."""
        errors = self.errors(iterations)
        return float((errors[-1] / errors[-5]) ** 0.25)

    def errors(self, iterations: int, size: float = 1e-4) -> list[float]:
        spans, count = self.parts.spans[0], len(self.parts.parts)
        states = np.array([0.0, 1.0]) + size * np.cos(7.0 * np.arange(2 * count).reshape(count, 2))
        mesh = np.linspace(0, 1, POINTS) + 0.1 * size * np.sin(9 * np.arange(POINTS))
        mesh[[0, -1]] = 0, 1
        errors = []
        for _ in range(iterations):
            for turn in turns(self.parts, self.settings.ordering):
                read, seen = states.copy(), mesh.copy()
                for k in turn:
                    states[k] = self._solved(k, read, seen)
                    span, whole = spans[k], self.settings.ordering is not em.Ordering.PARALLEL
                    first, last = (span.first, span.last) if whole else (span.owned_first, span.owned_last)
                    mesh[first : last + 1] = self._t(states[k], np.arange(first, last + 1))
            errors.append(float(np.abs(states - [0.0, 1.0]).max()))
        return errors

    def _solved(self, k: int, read: Array, seen: Array) -> Array:
        """Newton's method for two unknowns, by difference quotients."""
        state = read[k].copy()
        asked = [self._condition(k, end, read, seen) for end in (0, 1)]
        for _ in range(3):
            defect = np.array([f(state) for f in asked])
            moved = [(np.array([f(state + 1e-7 * e) for f in asked]) - defect) / 1e-7 for e in np.eye(2)]
            state = state - np.linalg.solve(np.column_stack(moved), defect)
        return state

    def _condition(self, k: int, end: int, read: Array, seen: Array) -> Callable[[Array], float]:
        """What is to vanish at one end of a subdomain."""
        span, side = self.parts.spans[0][k], 2 * end - 1
        if not 0 <= k + side < len(self.parts.parts):
            return lambda state: float(state[end] - end)
        node = span.last if end else span.first
        if isinstance(self.settings.transmission, em.Optimized):
            return self._yielding(node, end, seen)
        given = self._functional(read[k + side], node, end)
        return lambda state: self._functional(state, node, end) - given

    def _functional(self, state: Array, node: int, end: int) -> float:
        condition = self.settings.transmission
        before, x, after = self.density.positions(self._t(state, np.arange(node - 1, node + 2)))
        if isinstance(condition, em.Classical):
            return float(x)
        assert isinstance(condition, em.LinearRobin | em.NonlinearRobin)
        distance = (POINTS - 1 - node if end else node) / (POINTS - 1)
        slope = (after - before) * (POINTS - 1) / 2
        if isinstance(condition, em.NonlinearRobin):
            slope /= self.density.slope(float(self._t(state, np.array([node]))[0]))
        return float(slope + side_of(end) * condition.strength(distance) * x)

    def _yielding(self, node: int, end: int, seen: Array) -> Callable[[Array], float]:
        condition, side = self.settings.transmission, side_of(end)
        assert isinstance(condition, em.Optimized)
        squares = np.diff(seen) ** 2
        rest = squares[node:] if end else squares[:node]
        total = rest.sum() if condition.data is em.LineData.LINE_SUMS else len(rest) * rest[0 if end else -1]
        before, old, after = self.density.positions(seen[node - 1 : node + 2])
        weight = (after - before) / 2 / self.density.slope(seen[node]) ** 2

        def defect(state: Array) -> float:
            x = self.density.positions(self._t(state, np.array([node])))[0]
            own = (state[1] - state[0]) / (POINTS - 1)
            return float((own**2 - (total - side * 2 * weight * (x - old)) / len(rest)) * POINTS**2)

        return defect

    def _t(self, state: Array, nodes: npt.NDArray[np.int64]) -> Array:
        return np.asarray(state[0] + (state[1] - state[0]) * nodes / (POINTS - 1))


def side_of(end: int) -> int:
    return 1 if end else -1


def line(density: Density, settings: em.Schwarz) -> Line:
    return Line(density, settings.decompose(em.Grid(n_xi=POINTS, n_eta=9)), settings)


def plain(count: int, condition: em.TransmissionCondition, ordering: em.Ordering, overlap: int = 4) -> em.Schwarz:
    return em.Schwarz(
        subdomains=(count, 1),
        overlap=overlap,
        transmission=condition,
        ordering=ordering,
        line_correction=0,
        acceleration=em.Acceleration.NONE,
    )


@pytest.mark.parametrize("ordering", em.Ordering)
def test_classical_rates_hold_for_any_density(ordering: em.Ordering) -> None:
    case = line(BENT, plain(3, em.Classical(), ordering))
    assert case.rate(30) == pytest.approx(predicted_rate(case.parts, case.settings), abs=1e-3)
    assert steps_to_exact(case.parts, case.settings) is None


@pytest.mark.parametrize("ordering", [em.Ordering.PARALLEL, em.Ordering.COLOURED])
def test_robin_rates_hold_where_the_density_does_not_vary(ordering: em.Ordering) -> None:
    """The nonlinear condition compares p with a metric length: at a density of 2, it takes twice the p."""
    linear = line(LAYERED, plain(3, em.LinearRobin(p=20.0), ordering))
    predicted = predicted_rate(linear.parts, linear.settings)
    assert linear.rate(24) == pytest.approx(predicted, abs=2e-3)
    assert line(LAYERED, plain(3, em.NonlinearRobin(p=40.0), ordering)).rate(24) == pytest.approx(predicted, abs=2e-3)


def test_rates_by_hand() -> None:
    """Two strips: the formulas of the documentation."""
    alpha, beta, p = 15 / 32, 17 / 32, 5.0
    asked = {
        em.Classical(): alpha * (1 - beta) / (beta * (1 - alpha)),
        em.LinearRobin(p=p): ((p * (1 - beta) - 1) / (1 + p * beta)) * ((p * alpha - 1) / (1 + p * (1 - alpha))),
        em.LinearRobin(p=0.1): ((0.1 * (1 - beta) - 1) / (1 + 0.1 * beta)) * ((0.1 * alpha - 1) / (1.1 - 0.1 * alpha)),
    }
    for condition, factor in asked.items():
        for ordering, power in ((em.Ordering.PARALLEL, 0.5), (em.Ordering.ALTERNATING, 1.0)):
            case = line(BENT, plain(2, condition, ordering, overlap=3))
            assert predicted_rate(case.parts, case.settings) == pytest.approx(factor**power, rel=1e-12)


@pytest.mark.parametrize(
    ("ordering", "steps"),
    [
        (em.Ordering.PARALLEL, [2, 3, 8]),
        (em.Ordering.ALTERNATING, [2, 3, 8]),
        (em.Ordering.SYMMETRIC, [1, 1, 1]),
        (em.Ordering.COLOURED, [2, 2, 5]),
    ],
)
def test_automatic_p_is_exact_when_data_has_crossed_the_line(ordering: em.Ordering, steps: list[int]) -> None:
    settings = [plain(count, em.LinearRobin(), ordering) for count in (2, 3, 8)]
    assert [steps_to_exact(line(BENT, s).parts, s) for s in settings] == steps
    assert [predicted_rate(line(BENT, s).parts, s) for s in settings] == [0.0] * 3
    errors = line(LAYERED, settings[1]).errors(steps[1])
    assert errors[-1] < 1e-13
    assert all(error > 1e-6 for error in errors[:-1])


def test_linear_robin_takes_a_density_that_varies_for_another_p() -> None:
    """Its p less the slope of log m: with the automatic p it diverges where the nonlinear and the optimized do not."""
    ends = {}
    for condition in (em.LinearRobin(), em.NonlinearRobin(), em.Optimized()):
        errors = line(BENT, plain(3, condition, em.Ordering.ALTERNATING)).errors(6)
        ends[condition.name] = errors[-1] / errors[0]
    assert ends["linear_robin"] > 1.5
    assert ends["nonlinear_robin"] < 1e-5
    assert ends["optimized"] < 1e-7


def test_local_data_needs_an_overlap_where_the_owner_changes_elsewhere() -> None:
    """It reads the first edge beyond an interface in the merged mesh; with an overlap of 2 that is half the own one."""
    wide = line(BENT, plain(3, em.Optimized(data=em.LineData.LOCAL), em.Ordering.PARALLEL))
    assert (predicted_rate(wide.parts, wide.settings), steps_to_exact(wide.parts, wide.settings)) == (0.0, 3)
    errors = wide.errors(3)
    assert errors[1] > 1e-4
    assert errors[2] < 1e-6
    for count, ordering, factor in ((2, em.Ordering.PARALLEL, 7.5), (3, em.Ordering.SYMMETRIC, 50.5)):
        narrow = line(LAYERED, plain(count, em.Optimized(data=em.LineData.LOCAL), ordering, overlap=2))
        assert predicted_rate(narrow.parts, narrow.settings) == pytest.approx(factor, abs=0.1)
        errors = narrow.errors(5, size=1e-11)
        assert (errors[-1] / errors[-3]) ** 0.5 == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize("ordering", [em.Ordering.PARALLEL, em.Ordering.SYMMETRIC])
def test_line_sums_do_not_count_subdomains(ordering: em.Ordering) -> None:
    """The first error is of second order; what follows is that of the centred difference in the weights."""
    for count in (2, 4, 8, 16):
        case = line(BENT, plain(count, em.Optimized(), ordering, overlap=2))
        assert (predicted_rate(case.parts, case.settings), steps_to_exact(case.parts, case.settings)) == (0.0, 1)
        large, small = (case.errors(3, size) for size in (1e-3, 1e-4))
        assert small[0] < 0.1 * large[0] < 1e-6
        assert small[2] < 1e-5 * small[0]


def test_line_corrections_and_newton_leave_nothing_of_the_leading_part() -> None:
    for kind in (em.Classical(), em.LinearRobin(p=1.0), em.NonlinearRobin(), em.Optimized()):
        for settings in (em.Schwarz(transmission=kind, line_correction=1), em.Schwarz(acceleration="newton")):
            parts = settings.decompose(em.Grid(n_xi=17, n_eta=17))
            assert (predicted_rate(parts, settings), steps_to_exact(parts, settings)) == (0.0, 1)
    one = em.Schwarz(subdomains=(1, 1))
    parts = one.decompose(em.Grid(n_xi=17, n_eta=17))
    assert (predicted_rate(parts, one), steps_to_exact(parts, one)) == (None, 1)


def test_blocks_are_as_slow_as_their_slower_direction() -> None:
    settings = plain(4, em.Classical(), em.Ordering.COLOURED)
    grid = em.Grid(n_xi=33, n_eta=25)
    rates = []
    for subdomains in ((4, 1), (1, 3), (4, 3)):
        parts = Decomposition(grid=grid, subdomains=subdomains, overlap=4)
        rates.append(predicted_rate(parts, settings))
    assert rates[2] == max(rates[:2], key=lambda rate: rate or 0.0)
    assert rates[0] != rates[1]


def test_the_rate_of_a_mesh_is_the_predicted_one() -> None:
    """Robin with a number, on the paper's u, whose metric is flat where the interface lies."""
    settings = em.Schwarz(
        transmission=em.LinearRobin(p=20.0), overlap=2, tolerance=None, max_iterations=12, compare_single_domain=True
    )
    solution = em.solve(problem("paper", 17), settings)
    assert solution.predicted_rate is not None
    assert math.isclose(solution.rate or 0.0, solution.predicted_rate, abs_tol=0.01)
