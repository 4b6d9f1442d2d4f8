"""Solutions in parts, compared with those of one process."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes import rows
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.part_solution import PartSolution
from equimesh_cluster.parts.solve import CoarseSolution, OtherGridsNeededError, coarse_solution, solve_part

# Of the coarse solution, in place of a million.
COARSE_POINTS = 65 * 65


@pytest.fixture
def low_strips(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Strips of 16 rows also on small grids, which can then be cut into many parts."""
    caches = (rows.strips_of, rows._whole)
    for cache in caches:
        cache.cache_clear()
    monkeypatch.setattr(rows, "STRIP_NODES", 1_024)
    yield
    for cache in caches:
        cache.cache_clear()


def in_parts(
    problem: em.Problem,
    count: int,
    mode: em.Mode = em.Mode.DISCRETIZATION,
    points: int = COARSE_POINTS,
    threads: int = 1,
) -> list[PartSolution]:
    """The parts of a solution, each of which is shared by ``threads`` threads."""
    coarse = coarse_solution(problem, mode=mode, threads=1, max_points=points)

    def work(start: CoarseSolution, channel: Channel) -> PartSolution:
        return solve_part(problem, start.for_part(channel.number, count), channel, threads=threads)

    try:
        return ThreadChannels(count).run(partial(work, coarse))
    except OtherGridsNeededError:
        square = coarse_solution(problem, mode=mode, threads=1, max_points=coarse.grid.points, square=True)
        return ThreadChannels(count).run(partial(work, square))


def require_equal(found: list[PartSolution], whole: em.Solution) -> None:
    """The meshes are equal to the last bit, and so are all numbers of the solve."""
    for name in ("x", "y"):
        joined = np.concatenate([getattr(part.mesh, name)[part.mesh.own_rows] for part in found])
        assert np.array_equal(joined, getattr(whole.mesh, name)), name
        for part in found:
            held = getattr(whole.reference, name)[part.reference.rows.here]
            assert np.array_equal(getattr(part.reference, name), held), name
    for part in found:
        for name in ("status", "newton_steps", "residual", "note", "remedy", "relaxed", "mode"):
            assert repr(getattr(part, name)) == repr(getattr(whole, name)), name
        for name in ("algebraic_error", "discretization_error"):
            assert getattr(part, name) == getattr(whole, name), name
