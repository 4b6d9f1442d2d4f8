"""One pass over all samples in blocks: the same as at once, whatever the blocks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.fields import chunked_samples
from equimesh.fields.chunked_samples import scan, steps_of
from equimesh.io.sample_arrays import SampleArray

X, Y = np.linspace(0, 1, 31), np.linspace(0, 1, 23)
VALUES = np.random.default_rng(3).standard_normal((31, 23))


def stored(values: np.ndarray, chunk: tuple[int, int]) -> SampleArray:
    return SampleArray(name="values", path=Path("u.npy"), shape=values.shape, chunk=chunk, _stored=values)


@pytest.mark.parametrize("chunk", [(31, 23), (1, 23), (4, 5), (100, 100), (7, 1)], ids=str)
@pytest.mark.parametrize("most", [1, 60, 1 << 22])
def test_blocks_do_not_matter(monkeypatch: pytest.MonkeyPatch, chunk: tuple[int, int], most: int) -> None:
    monkeypatch.setattr(chunked_samples, "MAX_BLOCK_NUMBERS", most)
    found = scan(stored(VALUES, chunk), X, Y)
    size, steps = steps_of(VALUES)
    assert (found.low, found.high, found.size) == (VALUES.min(), VALUES.max(), size)
    assert found.steps == steps
    by_x, by_y = (np.abs(np.diff(VALUES, axis=axis)) for axis in (0, 1))
    assert (steps[0].size, steps[1].size) == (by_x.max(), by_y.max())
    assert by_x[steps[0].i, steps[0].j] == by_x.max()
    assert by_y[steps[1].i, steps[1].j] == by_y.max()


def test_every_chunk_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunked_samples, "MAX_BLOCK_NUMBERS", 100)

    class Counting:
        reads = np.zeros(VALUES.shape, dtype=int)

        def __getitem__(self, where: Any) -> np.ndarray:
            self.reads[where] += 1
            assert self.reads[where].size <= 100
            return VALUES[where]

    counting = Counting()
    scan(SampleArray(name="values", path=Path("u"), shape=(31, 23), chunk=(4, 5), _stored=counting), X, Y)
    assert np.all(counting.reads == 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e101])
def test_the_first_bad_sample_is_named(monkeypatch: pytest.MonkeyPatch, bad: float) -> None:
    monkeypatch.setattr(chunked_samples, "MAX_BLOCK_NUMBERS", 20)
    values = VALUES.copy()
    values[17, 11] = bad
    with pytest.raises(SamplesError, match=r"values\[17\]\[11\] (is NaN|is infinite|= 1e\+101)"):
        scan(stored(values, (4, 5)), X, Y)


def test_slopes_that_are_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunked_samples, "MAX_BLOCK_NUMBERS", 1)  # the two samples are in two blocks
    values = np.zeros((4, 3))
    values[2:] = 1e99
    y = np.array([0.0, 0.5, 1.0])
    assert scan(stored(values, (1, 3)), np.linspace(0, 1, 4), y).size == 1e99
    with pytest.raises(SamplesError, match=r"too fast along x .*: x\[1\] and x\[2\] are 1e-09 apart"):
        scan(stored(values, (1, 3)), np.array([0.0, 0.5, 0.5 + 1e-9, 1.0]), y)
    with pytest.raises(SamplesError, match="too fast along y"):
        scan(stored(values.T.copy(), (1, 1)), y, np.array([0.0, 0.5, 0.5 + 1e-9, 1.0]))
