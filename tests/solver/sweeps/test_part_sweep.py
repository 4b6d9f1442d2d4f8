"""One part of a sweep: it writes its own rows only, and all parts together do the work of the whole."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.parts import Parts
from equimesh.sweeps.kernels import Lines, Moved, Nodes
from equimesh.sweeps.line_sums import LineSums
from equimesh.sweeps.sweep import PartSweep
from solver.sweeps.windows import disturbed

SHAPE = (301, 257)


def swept(mesh: em.Mesh, case: em.Problem, threads: int) -> tuple[Moved, list[float]]:
    """Both phases on every part, one part after the other; what no part writes stays 7."""
    parts, summed = Parts.of(SHAPE, threads), SHAPE[0] - 1
    x, y, squares = (np.full(SHAPE, 7.0) for _ in range(3))
    out, sums = Moved(x, y, np.full((2, *SHAPE), 7.0, dtype=np.float32), squares), LineSums(parts, summed)
    none = [np.zeros((2, SHAPE[1 - k])) for k in (0, 1)]
    lines = [Lines(0, SHAPE[k] - 1, none[k], (0.0, 0.0), none[k]) for k in (0, 1)]
    nodes, still = Nodes(mesh.x, mesh.y), (np.zeros((2, SHAPE[1])), np.zeros((2, SHAPE[0])))
    sweeps = [PartSweep(case.metric, parts, part, summed) for part in parts.parts]
    found = [sweep.along_eta(nodes, None, still, lines[1], out, sums) for sweep in sweeps]
    sums.solve(lines[0])
    for sweep, part in zip(sweeps, parts.parts, strict=True):
        before = x.copy()
        found += sweep.along_xi(nodes, out, sums)
        inside = x[:, 1:-1] != before[:, 1:-1]
        others = np.delete(inside, np.s_[part.rows], axis=0)
        assert not others.any(), "a part writes its own rows only"
        assert inside.any()
    return out, found


@pytest.mark.parametrize("threads", [2, 3])
def test_parts_do_the_work_of_the_whole_to_the_last_bit(threads: int) -> None:
    case = problem("ring", *SHAPE)
    mesh = disturbed(case, 1e-4)
    (whole, (deviation, *most)), (cut, found) = (swept(mesh, case, count) for count in (1, threads))
    assert all(np.array_equal(one, other) for one, other in zip(whole, cut, strict=True))
    assert max(found[:threads]) == deviation
    assert [max(found[threads::2]), max(found[threads + 1 :: 2])] == most
