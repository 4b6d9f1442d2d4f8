"""What is made of several iterations, by setting."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import equimesh as em
from equimesh.schwarz.acceleration import Accelerator, ByAnderson, ByNewton, Unaccelerated, accelerator
from equimesh.schwarz.iteration import subdomains_of
from equimesh.schwarz.line_corrections import CorrectionResult
from solver.schwarz.bent import bent
from solver.schwarz.runs import PAPER, WHOLE
from solver.schwarz.solved import solved

MESHES = [bent(PAPER, size) for size in (4e-3, 2e-3, 1.2e-3)]


def made(kind: em.Acceleration) -> Accelerator:
    settings = em.Schwarz(acceleration=kind)
    return accelerator(settings, WHOLE, lambda: subdomains_of(PAPER, WHOLE, settings, enough=0.0, threads=1), 1e-14, 1)


def test_each_setting_has_its_accelerator() -> None:
    found = {kind: made(kind) for kind in (em.Acceleration.NONE, em.Acceleration.ANDERSON, em.Acceleration.NEWTON)}
    kinds = [type(one) for one in found.values()]
    assert kinds == [Unaccelerated, ByAnderson, ByNewton]
    assert [one.maps_merged_meshes for one in found.values()] == [False, False, True]


def test_unaccelerated_iterations_stay_as_they_are() -> None:
    corrected = CorrectionResult(MESHES[1], 0.01, 0.1, 1)
    found = made(em.Acceleration.NONE).apply(MESHES[0], corrected, solved(MESHES[1]), 0.0)
    assert found.mesh is MESHES[1]
    assert not found.is_combined


def combined_by_anderson(*, deviation: float = 0.01, estimate: float = 0.1, forget: bool = False) -> bool:
    """Whether the second of two iterations is combined with the first."""
    anderson, found = made(em.Acceleration.ANDERSON), None
    for before, after in itertools.pairwise(MESHES):
        if found is not None and forget:
            anderson.forget()
        found = anderson.apply(before, CorrectionResult(after, deviation, estimate, 1), solved(after), 1e-6)
    assert found is not None
    assert found.is_combined == (found.mesh is not MESHES[2])
    return found.is_combined


def test_anderson_combines_near_the_solution_as_long_as_it_is_needed() -> None:
    assert combined_by_anderson()
    assert not combined_by_anderson(deviation=0.2), "far away earlier changes say nothing of later ones"
    assert not combined_by_anderson(estimate=1e-7), "the error that is left is small enough"
    assert not combined_by_anderson(forget=True)


@pytest.mark.parametrize("failure", [{"stalled": True}, {"classical": True}], ids=str)
def test_newton_wants_what_all_subdomains_solved(failure: dict[str, bool]) -> None:
    corrected = CorrectionResult(MESHES[1])
    found = made(em.Acceleration.NEWTON).apply(MESHES[0], corrected, solved(MESHES[1], **failure), 0.0)
    assert np.array_equal(found.mesh.x, MESHES[1].x)
    assert (found.is_combined, found.products) == (False, 0)
