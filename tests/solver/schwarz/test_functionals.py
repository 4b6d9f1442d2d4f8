"""What subdomains send each other over their interfaces: the same data, wherever they are."""

from __future__ import annotations

import numpy as np

import equimesh as em
from cases import problem
from equimesh.schwarz.functionals import Exchange, SubdomainProblem
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.holding import OnChannel
from solver.schwarz.bent import bent

CASE = problem("paper", 18, 15)
BLOCKS = em.Decomposition(grid=CASE.grid, subdomains=(2, 2), overlap=3)
MESH = bent(CASE, 0.01)
PARTS = [SubdomainProblem(CASE, BLOCKS, part, em.NonlinearRobin()) for part in BLOCKS.parts]


def test_a_part_receives_what_a_neighbour_in_the_same_process_would_give() -> None:
    near = Exchange(MergedMeshes(BLOCKS), PARTS, has_substitute=True)
    near.read({k: part.window.restrict(MESH) for k, part in enumerate(PARTS)}, None)

    def compare(channel: Channel) -> tuple[int, dict[str, int]]:
        holding, compared = OnChannel(channel, BLOCKS), 0
        far = Exchange(holding, PARTS, has_substitute=True)
        far.read({k: PARTS[k].window.restrict(MESH) for k in holding.numbers}, [3, 0])
        for part in (PARTS[k] for k in holding.numbers if k in (0, 3)):
            for link in (*part.links, *map(part.classical, part.links)):
                one, other = far.functional(link), near.functional(link)
                assert np.array_equal(one.normal, other.normal)
                assert np.array_equal(one.tangential, other.tangential)
                compared += 1
            assert [far.node(corner) for corner in part.corner_links] == [near.node(c) for c in part.corner_links]
        return compared, holding.sent

    found = ThreadChannels(4).run(compare)
    assert sum(compared for compared, _ in found) == 8
    numbers = sum(4 * part.nodes(link.axis) for part in (PARTS[0], PARTS[3]) for link in part.links) + 2 * 2
    assert sum(sent.get("interfaces", 0) for _, sent in found) == 8 * numbers
    assert [bool(sent) for _, sent in found] == [True] * 4, "the first and the last one send to nobody but each other"
