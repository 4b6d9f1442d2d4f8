"""Files of a mesh in parts: every worker writes its part, and the caller writes the head."""

from __future__ import annotations

import os
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Client, Future

from equimesh.fields.field import Field
from equimesh.meshes.grid import Grid
from equimesh.numerics.channel import Channel
from equimesh.numerics.types import Array
from equimesh_cluster.part_files.contents import NodeValues, PartData
from equimesh_cluster.part_files.formats import parted_format
from equimesh_cluster.part_files.write import (
    leave_probe,
    remove_parted,
    require_folder,
    require_probe,
    write_head,
    write_part,
)
from equimesh_cluster.parts.measures import equidistribution_of_part
from equimesh_cluster.parts.part_solution import PartSolution
from equimesh_cluster.run import run_at


@dataclass(frozen=True, kw_only=True)
class FileNames:
    """The names of the arrays of a mesh in files, besides ``x`` and ``y``."""

    nodes: tuple[str, ...]
    """Names of the values at the nodes: ``u``, or nothing."""
    cells: tuple[str, ...]
    """Names of the values of the cells: ``Q_eq``, or nothing."""


def write_parts(
    client: Client,
    futures: Sequence[Future[PartSolution]],
    places: tuple[Grid, Sequence[int], Sequence[str]],
    path: str | os.PathLike[str],
    names: FileNames,
    format: str | None,
) -> Path:
    """Write the parts of a mesh, then its head. Returns the path of the head.

    ``places`` are the grid, the first row of every part but the first one, and the address of the worker of every part.
    Raises :class:`~equimesh.errors.InputError` for an unknown format, and for a folder that not all workers and the
    caller reach.
    """
    grid, cuts, workers = places
    head = Path(path).absolute()
    kind = parted_format(head, format).name
    require_folder(head)
    token = uuid.uuid4().hex
    probed = run_at(client, leave_probe_of_part, lambda k, _: (str(head), f"{token}-{k}"), workers)
    for number, machine in enumerate(client.gather(list(probed.futures))):
        require_probe(head, f"{token}-{number}", machine)
    remove_parted(head, format=kind)
    run_at(client, write_file_of_part, lambda k, _: (futures[k], str(head), names, kind), workers)
    return write_head(head, grid=grid, cuts=cuts, nodes=names.nodes, cells=names.cells, format=kind)


def leave_probe_of_part(_: Any, path: str, token: str) -> str:
    """Leave a file that the caller looks for. Runs on a worker."""
    return leave_probe(path, token)


def write_file_of_part(channel: Channel, part: PartSolution, path: str, names: FileNames, format: str) -> None:
    """Write the file of one part. Runs where the part is; u is evaluated for some rows at a time."""
    field = part.problem.monitor.u
    nodes: dict[str, NodeValues] = {} if field is None else {name: _Values(field) for name in names.nodes}
    cells = {name: equidistribution_of_part(part, channel) for name in names.cells}
    write_part(path, part.mesh, PartData(nodes=nodes, cells=cells), format=format)


class _Values:
    """The values of a field, as a function of x and y."""

    def __init__(self, field: Field) -> None:
        self._field = field

    def __call__(self, x: Array, y: Array) -> Array:
        return self._field.evaluate(x, y)[0]
