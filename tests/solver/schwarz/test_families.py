"""Each transmission condition has its family of subdomains."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.schwarz.functionals import FunctionalSubdomains
from equimesh.schwarz.iteration import subdomains_of
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.optimized import OptimizedSubdomains
from equimesh.schwarz.subdomains import Subdomains
from solver.schwarz.runs import PAPER

BLOCKS = em.Decomposition(grid=PAPER.grid, subdomains=(2, 2), overlap=3)


@pytest.mark.parametrize(
    ("condition", "family", "ghosts"),
    [
        (em.Classical(), FunctionalSubdomains, 0),
        (em.LinearRobin(), FunctionalSubdomains, 1),
        (em.NonlinearRobin(), FunctionalSubdomains, 1),
        (em.Optimized(), OptimizedSubdomains, 1),
    ],
    ids=lambda case: getattr(case, "name", ""),
)
def test_the_family_of_a_condition(condition: em.TransmissionCondition, family: type[Subdomains], ghosts: int) -> None:
    settings = em.Schwarz(transmission=condition, subdomains=(2, 2), overlap=3)
    found = subdomains_of(PAPER, MergedMeshes(BLOCKS), settings, enough=0.0, threads=1)
    assert isinstance(found, family)
    assert [window.shape for window in found.windows] == [
        (len(part.columns) + ghosts, len(part.rows) + ghosts) for part in BLOCKS.parts
    ]
    assert all(found.sent([k]) > 0 for k in range(4))
