"""Line corrections in windows: those of a sweep on the whole grid."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh.sweeps.sweep import Sweep, memory_needed
from equimesh_cluster.parts.holding import HeldSweep, OnChannel
from solver.schwarz.bent import bent

SECTOR = em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0))


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("domain", [em.Rectangle(x=(0, 1), y=(0, 1)), SECTOR], ids=["square", "sector"])
def test_two_corrections_are_those_of_the_whole_grid(boundary: em.Boundary, domain: em.Domain) -> None:
    """From a mesh whose sides move, too: they push the ends of all lines."""
    square = problem("tanh20", 26, 21, boundary=boundary)
    case = em.Problem(monitor=square.monitor, grid=square.grid, boundary=boundary, domain=domain)
    start, shape = bent(case, 0.005), square.grid.shape
    whole = Sweep(case.metric, boundary, Parts.of(shape), np.empty(memory_needed(shape)))
    x, y, expected = start.x.copy(), start.y.copy(), []
    for _ in range(2):
        found = whole.correct(x, y)
        smallest = whole.smallest_jacobian
        x, y = whole.swap(x, y)
        expected.append((found.deviation, found.move, smallest))
    decomposition = em.Decomposition(grid=case.grid, subdomains=(3, 2), overlap=2)

    def correct(channel: Channel) -> em.Mesh | None:
        holding = OnChannel(channel, decomposition)
        sweep, mesh = HeldSweep(case, holding), holding.cut(start)
        held_x, held_y = mesh.x, mesh.y
        for numbers in expected:
            here = sweep.correct(held_x, held_y)
            assert (here.deviation, here.move, sweep.smallest_jacobian) == pytest.approx(numbers, rel=1e-9)
            held_x, held_y = sweep.swap(held_x, held_y)
        return holding.assembled(em.Mesh(held_x, held_y), "shown")

    mesh = ThreadChannels(4).run(correct)[0]
    assert mesh is not None
    assert max(abs(mesh.x - x).max(), abs(mesh.y - y).max()) < 1e-14
    assert expected[0][1] > 1e-3, "the nodes do move"
