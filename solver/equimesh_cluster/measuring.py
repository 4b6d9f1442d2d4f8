"""The quality and the certificate of a mesh that stays on the workers of a cluster."""

from __future__ import annotations

from distributed import Client

from equimesh.numerics.channel import Channel
from equimesh_cluster.parts.measures import PartMeasures, measure_part
from equimesh_cluster.parts.part_solution import PartSolution
from equimesh_cluster.run import PartsRun, run_at


def measures_of(client: Client, run: PartsRun) -> PartMeasures:
    """The measures of the whole mesh, from one task for each part of ``run`` where that part is.

    Values of single cells are not in it. Nothing of it is left on the workers. Raises
    :class:`~equimesh_cluster.errors.WorkersLostError` where one of them is lost.
    """
    found = run_at(client, _of_part, lambda number, _: (run.futures[number],), run.workers)
    result: PartMeasures = found.futures[0].result()
    return result


def _of_part(channel: Channel, part: PartSolution) -> PartMeasures:
    return measure_part(part, channel).without_cells()
