"""The meshes of an iteration that are kept while it runs."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh_service.worker import drawing as module
from equimesh_service.worker.drawing import Frames


def records(count: int) -> list[Any]:
    """The real records of so many iterations, and the start."""
    found: list[Any] = []
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(9*x)")), grid=em.Grid(n_xi=8, n_eta=7))
    settings = em.Schwarz(transmission=em.Classical(), overlap=2, tolerance=None, max_iterations=count)
    em.solve(problem, settings, observe=found.append)
    return [event for event in found if isinstance(event, em.Iteration)]


def test_all_meshes_of_a_short_iteration_are_kept() -> None:
    events, frames = records(5), Frames(56)
    for event in [SimpleNamespace(iteration=0), *events]:  # events of the start have no mesh of the iteration
        frames(event)
    arrays = frames.arrays()
    assert frames.numbers == [*range(6)]
    for number, event in enumerate(events):
        assert np.array_equal(arrays["frames_x"][number], event.mesh.x.astype(np.float32))
        assert np.array_equal(arrays["frames_y"][number], event.mesh.y.astype(np.float32))


@pytest.mark.parametrize(("most", "kept"), [(12, [*range(12)]), (11, [0, 2, 4, 6, 8, 10, 11]), (4, [0, 4, 8, 11])])
def test_a_long_iteration_is_thinned_evenly_and_has_its_end(
    monkeypatch: pytest.MonkeyPatch, most: int, kept: list[int]
) -> None:
    monkeypatch.setattr(module, "MAX_COORDINATES", most * 56)
    monkeypatch.setattr(module, "MIN_FRAMES", 2)
    events, frames = records(11), Frames(56)
    for event in events:
        frames(event)
    arrays = frames.arrays()
    assert frames.numbers == kept
    assert arrays["frames_y"].shape == (len(kept), 8, 7)
    assert np.array_equal(arrays["frames_x"][-1], events[-1].mesh.x.astype(np.float32))


def test_only_the_last_of_two_iterations_is_kept() -> None:
    frames = Frames(56)
    for event in [*records(5), *records(3)]:
        frames(event)
    assert len(frames.arrays()["frames_x"]) == 4
    assert frames.numbers == [*range(4)]


def test_without_an_iteration_there_are_no_frames() -> None:
    assert Frames(56).arrays() == {}
