"""What the driver has of a solution in parts."""

from __future__ import annotations

from distributed import Client

import equimesh as em
from equimesh.numerics.channel import Traffic
from equimesh_cluster.handle import summary_of, traffic_of
from meshes_on_workers import PROBLEM, parts_on


def test_a_summary_has_everything_but_the_rows(client: Client) -> None:
    solution = em.solve(PROBLEM)
    run = parts_on(client, solution, 10, 20)
    summaries = client.gather([client.submit(summary_of, future, pure=False) for future in run.futures])
    assert [(summary.first, summary.last) for summary in summaries] == [(0, 10), (10, 20), (20, 33)]
    assert {summary.status for summary in summaries} == {solution.status}
    assert {summary.newton_steps for summary in summaries} == {solution.newton_steps}
    assert not hasattr(summaries[0], "mesh")
    assert traffic_of(summaries) == {"halo": Traffic(6, 60)}
