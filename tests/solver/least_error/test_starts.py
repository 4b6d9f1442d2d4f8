"""Rectilinear starts: lines equidistribute the density of least error, and layers are found in few passes."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import ways
from equimesh.least_error.ways import product, rectilinear, resampled
from solver.bent import SECTOR

SQUARE = em.Rectangle()


class Counted:
    """A field that counts how often it is evaluated: twice a pass."""

    def __init__(self, text: str) -> None:
        self.u, self.calls = em.Expression(text), 0

    def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
        self.calls += 1
        return self.u.evaluate(x, y, order)


def lines(text: str, count: int = 65, floor: float = 0.1, norm: str = "l2") -> tuple[np.ndarray, np.ndarray]:
    found = rectilinear(em.Expression(text), SQUARE, (count, count), norm, floor)  # type: ignore[arg-type]
    assert found is not None
    return found


@pytest.mark.parametrize(("norm", "power"), [("l2", 0.4), ("h1", 2 / 3)])
def test_lines_equidistribute_the_density_of_least_error(norm: str, power: float) -> None:
    # |u_xx|^(2/5) for exp(-x/w) is exp(-2 x/(5 w)), plus the floor times its mean.
    s, _ = lines("exp(-6*x)*(2 + y)", count=201, floor=0.1, norm=norm)
    mean = (1 - np.exp(-6 * power)) / (6 * power)
    integral = (1 - np.exp(-6 * power * s)) / (6 * power) + 0.1 * mean * s
    assert np.diff(integral) == pytest.approx(np.full(200, 1.1 * mean / 200), rel=0.02)


def test_what_does_not_depend_on_y_leaves_its_lines_alone() -> None:
    s, t = lines("tanh(30*(x - 0.4))")
    assert np.array_equal(t, np.linspace(0, 1, 65))
    assert np.diff(s).min() < 0.2 / 64


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4])
def test_layers_are_found(width: float) -> None:
    s, t = lines(f"exp(-x/{width}) + exp((y - 1)/{width})", floor=0.01)
    assert np.count_nonzero(s < 5 * width) > 20
    assert np.count_nonzero(t > 1 - 5 * width) > 20


@pytest.mark.parametrize(
    ("text", "passes"), [("exp(-x/0.1)", 4), ("exp(-x/0.001) + exp(-y/0.001)", 8), ("x + y", 1), ("x*x + y*y", 1)]
)
def test_it_takes_few_passes(text: str, passes: int) -> None:
    u = Counted(text)
    rectilinear(u, SQUARE, (33, 33), "l2", 0.1)
    assert u.calls <= 2 * passes


@pytest.mark.parametrize("text", ["abs(x - 0.3)", "tanh(300*(x + y - 1))", "1e200*tanh(50*x*y)", "1e-200*exp(-50*x)"])
@pytest.mark.parametrize("floor", [1.0, 0.1, 0.01])
def test_lines_keep_their_order_and_ends(text: str, floor: float) -> None:
    for line in lines(text, floor=floor):
        assert (line[0], line[-1]) == (0.0, 1.0)
        assert np.diff(line).min() > 0.0


def test_more_floor_leaves_more_lines_where_u_is_flat() -> None:
    flat = [np.count_nonzero(lines("tanh(100*(x - 0.3))", floor=floor)[0] > 0.4) for floor in (0.01, 0.1, 1.0)]
    assert flat[0] < flat[1] < flat[2]


def test_the_lines_of_a_sector_follow_its_radius() -> None:
    u = em.Expression("exp(-40*(hypot(x - 0.3, y + 0.4) - 0.6))")
    found = rectilinear(u, SECTOR, (33, 33), "l2", 0.1)
    assert found is not None
    graded = [np.diff(line).max() / np.diff(line).min() for line in found]
    assert sorted(graded)[0] == pytest.approx(1.0, abs=1e-6)
    assert sorted(graded)[1] > 5


def test_there_are_none_where_u_is_not_finite() -> None:
    with np.errstate(all="ignore"):
        assert rectilinear(em.Expression("log(x - 0.5)"), SQUARE, (9, 9), "l2", 0.1) is None


@pytest.mark.parametrize("text", ["sqrt(x)*(1 + y)", "(x**2 + y**2)**(1/3)"])
def test_infinite_slopes_on_a_side_draw_lines_to_it(text: str) -> None:
    with np.errstate(all="ignore"):
        s, _ = lines(text)
    assert np.diff(s)[0] == np.diff(s).min() < 0.3 / 64


def test_rounding_does_not_draw_lines() -> None:
    assert np.array_equal(lines("3*x + 5*y + 7")[0], np.linspace(0, 1, 65))


def test_resampling_keeps_lines_monotone_and_ends() -> None:
    line = np.array([0.0, 0.001, 0.002, 0.5, 0.9, 1.0])
    for count in (4, 6, 11, 40):
        fine = resampled(line, count)
        assert fine.size == count
        assert (fine[0], fine[-1]) == (0.0, 1.0)
        assert np.diff(fine).min() > 0.0
    assert resampled(line, 6) is line
    assert resampled(line, 11)[::2] == pytest.approx(line, abs=1e-15)
    assert resampled(np.array([0.0, 1.0]), 5) == pytest.approx(np.linspace(0, 1, 5), abs=0)


def test_a_product_has_straight_lines() -> None:
    mesh = product(np.array([0.0, 0.2, 1.0]), np.array([0.0, 1.0]))
    assert mesh.tolist() == [[0, 0, 0.2, 0.2, 1, 1], [0, 1, 0, 1, 0, 1]]


def test_passes_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways, "MAX_PASSES", 2)
    u = Counted("exp(-x/0.0001)")
    rectilinear(u, SQUARE, (33, 33), "l2", 0.01)
    assert u.calls == 2  # one for both families, as few lines cross
