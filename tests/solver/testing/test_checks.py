# ruff: noqa: ARG001, ARG005 - most of what a spoiler is given does not matter to it
"""The kit of fields: the project's own fields pass it, and it refuses each broken promise."""

from __future__ import annotations

import tempfile
from collections.abc import Callable

import numpy as np
import pytest

import equimesh as em
from equimesh.testing import check_field

AXIS = np.linspace(0.0, 1.0, 21)
VALUES = np.sin(4 * AXIS)[:, None] * np.cos(3 * AXIS)
BENT = em.Mesh(AXIS[:, None] + 0.05 * np.sin(np.pi * AXIS)[:, None] * AXIS, np.tile(AXIS, (21, 1)))
SCATTERED = np.vstack([np.random.default_rng(1).uniform(size=(400, 2)), [(0, 0), (1, 0), (1, 1), (0, 1)]])


def chunked() -> em.ChunkedSamples:
    """The same samples in a file; the file stays open when its name is gone."""
    with tempfile.TemporaryDirectory() as folder:
        np.save(f"{folder}/u.npy", VALUES)
        return em.ChunkedSamples(path=f"{folder}/u.npy")


FIELDS: dict[str, Callable[[], em.Field]] = {
    "expression": lambda: em.Expression("tanh(20*(x + y/2 - 0.75))"),
    "expression with kinks": lambda: em.Expression("abs(x - 0.5) + where(y > 0.3, y, 0.3)"),
    "grid": lambda: em.GridSamples(x=AXIS, y=AXIS, values=VALUES),
    "chunked": chunked,
    "scattered": lambda: em.ScatteredSamples(points=SCATTERED, values=np.sin(4 * SCATTERED[:, 0]) * SCATTERED[:, 1]),
    "nodal": lambda: em.NodalField(mesh=BENT, values=VALUES),
}
Arrays = tuple[np.ndarray, ...]


@pytest.mark.parametrize("name", FIELDS)
def test_own_fields_pass(name: str) -> None:
    check_field(FIELDS[name]())


def test_a_field_passes_on_a_box_of_its_own() -> None:
    samples = em.GridSamples(x=100 * AXIS - 3, y=1e-3 * AXIS, values=VALUES, box=((-3.0, 97.0), (0.0, 1e-3)))
    check_field(samples, box=((-3.0, 97.0), (0.0, 1e-3)))


class Broken:
    """A right field, sin(2 x) exp(y), whose results pass through ``spoil(x, y, order, results)``."""

    def __init__(self, spoil: Callable[[np.ndarray, np.ndarray, int, list[np.ndarray]], object]) -> None:
        self.spoil = spoil

    def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> Arrays:
        s, c, e = np.sin(2 * x), np.cos(2 * x), np.exp(y)
        results = [s * e, 2 * c * e, s * e, -4 * s * e, 2 * c * e, s * e][: (1, 3, 6)[order]]
        changed = self.spoil(x, y, order, results)
        return tuple(results) if changed is None else changed  # type: ignore[return-value]


def scale(part: int, orders: tuple[int, ...] = (1, 2)) -> Callable[..., None]:
    """Makes one derivative wrong by a thousandth."""

    def spoil(x: np.ndarray, y: np.ndarray, order: int, results: list[np.ndarray]) -> None:
        if order in orders and part < len(results):
            results[part] = 1.001 * results[part]

    return spoil


def write(x: np.ndarray, y: np.ndarray, order: int, results: list[np.ndarray]) -> None:
    if x.size > 100:
        x += 1.0


def drift(x: np.ndarray, y: np.ndarray, order: int, results: list[np.ndarray], calls: list[int] = []) -> None:  # noqa: B006
    calls.append(1)
    results[0] = results[0] + 1e-6 * len(calls)


def mean(x: np.ndarray, y: np.ndarray, order: int, results: list[np.ndarray]) -> None:
    results[0] = results[0] + (x.mean() if x.size else 0.0)


def numbered(x: np.ndarray, y: np.ndarray, order: int, results: list[np.ndarray]) -> None:
    results[0] = results[0] + np.arange(x.size).reshape(x.shape)


def hole(x: np.ndarray, y: np.ndarray, order: int, results: list[np.ndarray]) -> None:
    results[0] = np.where((x == 1.0) & (y == 0.0), np.nan, results[0])


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda x, y, order, results: tuple(r.ravel() for r in results), r"u has shape \(1,\) at points of \(\)"),
        (lambda x, y, order, results: tuple(results[:1]), r"must return the tuple \(u, u_x, u_y\), not 1 values"),
        (lambda x, y, order, results: list(results), "must return the tuple .* not list"),
        (write, "writes into its arguments"),
        (drift, "does not repeat itself: u differs by"),
        (numbered, "depends on the order of the points: u differs by"),
        (mean, "of some of the points differs from that of all: u differs by"),
        (hole, r"u is not finite at \(1, 0\)"),
        (scale(1), r"u_x of order 1 = .* is wrong by .* at \(.*\): the Taylor remainder"),
        (scale(2, (2,)), "u_y of order 2 = .* is wrong by"),
        (scale(3), "u_xx = .* is wrong by"),
        (scale(4), "u_xy = .* is wrong by"),
        (scale(5), "u_yy = .* is wrong by"),
    ],
)
def test_broken_promises_are_refused(spoil: Callable[..., object], sentence: str) -> None:
    check_field(Broken(lambda x, y, order, results: None))
    with pytest.raises(AssertionError, match=sentence):
        check_field(Broken(spoil))
