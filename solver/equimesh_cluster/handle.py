"""A solution that stays on the workers of a cluster: its arrays, summaries, measures and files."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import dask.array as da
from dask.delayed import delayed
from dask.sizeof import sizeof
from distributed import Client, Future

from equimesh.equations.problem import Problem
from equimesh.fields.expression import Field
from equimesh.meshes.mesh import Grid
from equimesh.numerics.types import Array
from equimesh.quality.measures import Quality
from equimesh.solving.certificate import Certificate
from equimesh.solving.status import Status
from equimesh_cluster.connection import close_after
from equimesh_cluster.errors import ClusterError, WorkersLostError
from equimesh_cluster.messages import Channel, Traffic, added
from equimesh_cluster.part_files.formats import NodeValues, PartData, parted_format
from equimesh_cluster.part_files.parted_mesh import (
    leave_probe,
    remove_parted,
    require_folder,
    require_probe,
    write_head,
    write_part,
)
from equimesh_cluster.parts.part_solution import (
    PartMeasures,
    PartRecord,
    PartSolution,
    PartStep,
    equidistribution_of_part,
    measure_part,
)
from equimesh_cluster.run import PartsRun, run_at
from equimesh_schema import Relaxed

# Dask arrays of what stays on the workers: one chunk for each part, which is a view of its rows.


@sizeof.register(PartSolution)  # type: ignore[untyped-decorator]
def bytes_of(part: PartSolution) -> int:
    """The memory of a part, which Dask has to know: it would move what seems small to where it is needed."""
    return part.mesh.x.nbytes + part.mesh.y.nbytes + part.reference.x.nbytes + part.reference.y.nbytes


def array_of(
    futures: Sequence[Future[PartSolution]],
    rows: Sequence[int],
    n_eta: int,
    values: Callable[[PartSolution], Array],
) -> Any:
    """The dask array whose chunk k is ``values`` of part k, of shape ``(rows[k], n_eta)``."""
    of_part = delayed(values, pure=False)
    chunks = [
        da.from_delayed(of_part(future), shape=(height, n_eta), dtype=float)
        for future, height in zip(futures, rows, strict=True)
    ]
    return da.concatenate(chunks, axis=0)


def own_x(part: PartSolution) -> Array:
    """x at the nodes of a part: a view, not a copy."""
    return part.mesh.x[part.mesh.own_rows]


def own_y(part: PartSolution) -> Array:
    """y at the nodes of a part: a view, not a copy."""
    return part.mesh.y[part.mesh.own_rows]


def own_u(part: PartSolution) -> Array:
    """u at the nodes of a part. Raises :class:`ValueError` where the monitor has no u."""
    field = part.problem.monitor.u
    if field is None:
        raise ValueError("the monitor has no u")
    return field.evaluate(own_x(part), own_y(part))[0]


# What the driver has of a solution in parts: everything but the rows.


@dataclass(frozen=True, kw_only=True, eq=False)
class Summary(PartRecord):
    """One part without its rows. ``first`` and ``last`` are its own rows, as numbers of the grid."""

    first: int
    last: int


def summary_of(part: PartSolution) -> Summary:
    """The summary of a part. Runs where the part is."""
    record: dict[str, Any] = {field.name: getattr(part, field.name) for field in fields(PartRecord)}
    return Summary(first=part.mesh.first, last=part.mesh.last, **record)


# The quality and the certificate of a mesh that stays on the workers of a cluster.


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


# Files of a mesh in parts: every worker writes its part, and the caller writes the head.


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


class Handle:
    """The mesh of a problem, in parts that stay on the workers which computed them.

    It is a context manager: at its end nothing of the solve is left on the workers. The same holds after
    :meth:`close`, and when nobody refers to it or its arrays any more. A client that was made for it is closed then.

    ``quality``, ``certificate``, ``write`` and ``each`` run on all its workers. Each waits, without a time limit, until
    no other solve or handle runs on them.
    """

    def __init__(self, problem: Problem, client: Client, run: PartsRun, *, own_client: bool) -> None:
        self.problem, self.workers, self.attempts = problem, run.workers, run.attempts
        self._client, self._run, self._own_client = client, run, own_client
        futures = [client.submit(summary_of, future, pure=False) for future in run.futures]
        self._summaries: list[Summary] = client.gather(futures)
        self._measured: PartMeasures | None = None
        if own_client:
            close_after(client, run.futures)

    def __repr__(self) -> str:
        return f"<Handle: {self.grid} points, {self.status}, {self.count} parts>"

    @property
    def grid(self) -> Grid:
        """The grid of the mesh."""
        return self.problem.grid

    @property
    def count(self) -> int:
        """The number of parts."""
        return len(self._summaries)

    @property
    def cuts(self) -> tuple[int, ...]:
        """The first row of every part but the first one."""
        return tuple(summary.first for summary in self._summaries[1:])

    @property
    def status(self) -> Status:
        """The end of the solve."""
        return self._whole.status

    @property
    def newton_steps(self) -> int:
        """The number of sweeps on the requested grid."""
        return self._whole.newton_steps

    @property
    def residual(self) -> float:
        """The largest relative deviation of a squared metric length from the mean of its line, at the end."""
        return self._whole.residual

    @property
    def note(self) -> str:
        """The differences from the requested mesh; empty where there are none."""
        return self._whole.note

    @property
    def remedy(self) -> str:
        """The remedy in a sentence; empty where none is needed."""
        return self._whole.remedy

    @property
    def message(self) -> str:
        """The status in a sentence, its details, and the remedy."""
        return " ".join(text for text in (self.status.sentence, self.note, self.remedy) if text)

    @property
    def relaxed(self) -> tuple[Relaxed, ...]:
        """The differences between the requested equations and those that the mesh satisfies."""
        return self._whole.relaxed

    @property
    def algebraic_error(self) -> float | None:
        """The estimated distance from the exact solution of the discrete equations."""
        return self._whole.algebraic_error

    @property
    def discretization_error(self) -> float | None:
        """The estimated distance from the mesh that infinitely many points would have."""
        return self._whole.discretization_error

    @property
    def records(self) -> tuple[tuple[PartStep, ...], ...]:
        """The records of every part: one for each sweep on the levels that were solved in parts."""
        return tuple(summary.records for summary in self._summaries)

    @property
    def traffic(self) -> dict[str, Traffic]:
        """The messages that all parts sent, and their bytes, by the kind of the message."""
        return added(record.traffic for summary in self._summaries for record in summary.records)

    @property
    def x(self) -> Any:
        """x at the nodes: a dask array of shape ``(n_xi, n_eta)``, with one chunk for each part."""
        return self._array(own_x)

    @property
    def y(self) -> Any:
        """y at the nodes: a dask array of shape ``(n_xi, n_eta)``, with one chunk for each part."""
        return self._array(own_y)

    @property
    def u(self) -> Any:
        """u at the nodes, as a dask array that is computed when it is needed; ``None`` where there is no u."""
        return None if self.problem.monitor.u is None else self._array(own_u)

    def quality(self) -> Quality:
        """The quality measures of the mesh, as in :attr:`equimesh.Solution.quality`, without values of single cells.

        Every part measures its cells. The measures wait while another solve runs on the workers.
        """
        return self._measures().quality

    @property
    def certificate(self) -> Certificate:
        """The certificate of the mesh, as in :attr:`equimesh.Solution.certificate`.

        It is measured with the quality. It waits while another solve runs on the workers.
        """
        return self._measures().certificate

    def write(self, path: str | os.PathLike[str], *, format: str | None = None, q_eq: bool = True) -> Path:
        """Write the mesh, Q_eq, and u where there is one: every worker its part, then the caller the head.

        Returns the path of the head. ``q_eq=False`` leaves Q_eq out, which is measured when it is written.
        The suffix of ``path`` decides on the format, unless ``format`` is a name in
        :data:`~equimesh_cluster.PARTED_FORMATS`. An older mesh of the same name is removed before
        the first part is written. It waits while another solve runs on the workers. Raises
        :class:`~equimesh.errors.InputError` for an unknown format, and for a folder that not all workers and the caller
        reach by the same name.
        """
        self._require_parts()
        names = FileNames(nodes=() if self.problem.monitor.u is None else ("u",), cells=("Q_eq",) if q_eq else ())
        places = self.grid, self.cuts, self.workers
        return write_parts(self._client, self._run.futures, places, path, names, format)

    def each(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """The results of ``function(channel, part, *arguments)``, called for every part on the worker that holds it.

        ``part`` is a :class:`~equimesh_cluster.parts.part_solution.PartSolution`; the results should be small. It
        waits while another solve runs on the workers. Raises what the function raises.
        """
        self._require_parts()
        run = run_at(self._client, function, lambda k, _: (self._run.futures[k], *arguments), self.workers)
        return list(self._client.gather(list(run.futures)))

    def close(self) -> None:
        """Remove all parts from the workers. Dask arrays of them cannot be computed after that."""
        futures, self._run = list(self._run.futures), PartsRun((), (), 0)
        if futures and self._client.status == "running":
            self._client.cancel(futures, force=True)
        if self._own_client:
            self._client.close()

    def __enter__(self) -> Handle:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _measures(self) -> PartMeasures:
        """The quality and the certificate, which are measured together and once."""
        if self._measured is None:
            self._require_parts()
            self._measured = measures_of(self._client, self._run)
        return self._measured

    @property
    def _whole(self) -> Summary:
        """The numbers that are the same for all parts."""
        return self._summaries[0]

    @cached_property
    def _rows(self) -> list[int]:
        return [summary.last - summary.first for summary in self._summaries]

    def _array(self, values: Callable[[PartSolution], Any]) -> Any:
        self._require_parts()
        return array_of(self._run.futures, self._rows, self.grid.n_eta, values)

    def _require_parts(self) -> None:
        """Raise where the parts are not on the workers any more."""
        if not self._run.futures:
            raise ClusterError("this handle is closed, and its mesh is gone: solve again")
        alive = self._client.nthreads(workers=sorted(set(self.workers)))
        lost = tuple(sorted(set(self.workers) - set(alive)))
        if lost or any(future.status != "finished" for future in self._run.futures):
            names = ", ".join(lost) or "workers"
            raise WorkersLostError(f"{names} ended, and with them parts of the mesh: solve again", lost=lost)


class PartsError(ClusterError):
    """A solve in parts that ended without the requested mesh. ``handle`` has what there is; close it."""

    def __init__(self, message: str, handle: Handle) -> None:
        super().__init__(message)
        self.handle = handle
