"""Cells chosen among those of all processes: the same ones, however they are shared out."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh_window import Rows
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh.quality import resolution
from equimesh.quality.resolution import all_but_the_smallest, largest_of

VALUES = np.abs(np.random.default_rng(3).standard_normal(1000)) * 10.0 ** np.random.default_rng(4).integers(-9, 9, 1000)


def alone(count: int, channel: Channel) -> Rows:
    """Rows of so many cells, of which those of every process begin at 0."""
    return Rows(shape=(count + 1, 2), begin=0, first=0, last=count, channel=channel)


def in_parts(values: np.ndarray, cuts: list[int], count: int) -> np.ndarray:
    """The places of the largest values, from one process for each piece of the values."""
    pieces, ends = np.split(values, cuts), [0, *cuts, values.size]

    def work(channel: Channel) -> np.ndarray:
        k = channel.number
        rows = Rows(shape=(values.size + 1, 2), begin=ends[k], first=ends[k], last=ends[k + 1], channel=channel)
        return ends[k] + largest_of(pieces[k], count, rows)

    return np.concatenate(ThreadChannels(len(pieces)).run(work))


@pytest.mark.parametrize("sent", [0, 5, 100, 4096])
@pytest.mark.parametrize("cuts", [[], [1], [300, 310, 900]])
@pytest.mark.parametrize("count", [1, 27, 999])
def test_the_largest_are_those_at_the_end_of_the_sorted_ones(
    cuts: list[int], count: int, sent: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resolution, "MAX_SENT", sent)
    assert np.array_equal(in_parts(VALUES, cuts, count), np.sort(np.argsort(VALUES)[-count:]))


@pytest.mark.parametrize("sent", [0, 4096])
def test_the_first_of_equal_values_are_taken_and_nan_before_all(sent: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resolution, "MAX_SENT", sent)
    values = np.repeat([2.0, 1.0, np.nan, 1.0, 0.0], 4)
    for cuts in ([], [5], [6, 14]):
        assert in_parts(values, cuts, 10).tolist() == [0, 1, 2, 3, 4, 5, 8, 9, 10, 11]


@pytest.mark.parametrize("parts", [1, 3])
def test_the_values_that_are_taken_away_have_about_the_allowed_sum(parts: int) -> None:
    pieces = np.array_split(VALUES, parts)
    for share in (1e-6, 0.01, 0.5):
        allowed = share * VALUES.sum()

        def work(channel: Channel, allowed: float = allowed) -> np.ndarray:
            return all_but_the_smallest(pieces[channel.number], allowed, alone(VALUES.size, channel))

        kept = np.concatenate(ThreadChannels(parts).run(work))
        assert VALUES[~kept].sum() <= 1.02 * allowed
        assert VALUES[~kept].max() < VALUES[kept].min()
        assert VALUES[~kept].sum() + 1.05 * VALUES[kept].min() * (1.05 * VALUES[kept].min() > VALUES).sum() > allowed


def test_nothing_is_left_of_what_is_allowed_and_nan_never() -> None:
    def of(values: list[float], allowed: float) -> list[bool]:
        return all_but_the_smallest(np.array(values), allowed, Rows.whole((len(values) + 1, 2))).tolist()

    assert of([1.0, 2.0, 0.0], 3.5) == [False, False, False]
    assert of([1.0, 2.0, 0.0], 0.0) == [True, True, False]
    assert of([1.0, np.inf, np.nan], 2.0) == [False, True, False]
