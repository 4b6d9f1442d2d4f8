"""A mesh in parts: its formats and files, and its solve by the whole cluster.

The process holds the records of the solve, and no row of the mesh: each worker writes the file of its part into the
storage of the service. Where the process is killed, the cluster gives up the parts, since their client is gone.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from equimesh import Field, Grid, SolveError
from equimesh.numerics.types import Array
from equimesh.specs.spec import AUTOMATIC_PARTS, BuiltSpec
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.part_files.formats import NodeValues, PartData
from equimesh_cluster.part_files.parted_mesh import write_head, write_part
from equimesh_cluster.part_files.pvtu import Piece
from equimesh_service.assembly.problem import translate_errors
from equimesh_service.errors import FilesError, WorkerLostError
from equimesh_service.files.port import Files, Removed, StoredFile
from equimesh_service.problems.problem import Problem
from equimesh_service.store.rows import Artifact, Ending, Outcome
from equimesh_service.store.store import Store
from equimesh_service.telemetry import tracing
from equimesh_service.worker.job import Job, Storage, head_name, part_artifact
from equimesh_service.worker.part_formats import PART_FORMATS, WRITTEN
from equimesh_service.worker.reporter import Reporter

if TYPE_CHECKING:
    from equimesh.solving.solution import Solution
    from equimesh_cluster import Handle
    from equimesh_cluster.parts.part_solution import PartSolution


@dataclass(frozen=True, kw_only=True)
class PartsLayout:
    """The parts of a mesh: their first rows, the name in the files, and the names of arrays at nodes."""

    name: str
    grid: Grid
    firsts: tuple[int, ...]
    nodes: tuple[str, ...]

    @classmethod
    def of(cls, parts: Mapping[str, Any], grid: Grid) -> PartsLayout:
        """The layout that the result of a mesh describes, as :meth:`record` does."""
        firsts = tuple(int(first) for first, _ in parts["rows"])
        return cls(name=str(parts["name"]), grid=grid, firsts=firsts, nodes=tuple(parts["nodes"]))

    def record(self) -> dict[str, Any]:
        """The layout as JSON, without the grid."""
        return {"name": self.name, "rows": [list(rows) for rows in self.rows], "nodes": list(self.nodes)}

    @property
    def rows(self) -> tuple[tuple[int, int], ...]:
        """The first row of each part, and the first row of the next part."""
        return tuple(pairwise((*self.firsts, self.grid.n_xi)))


def write_part_file(path: Path, part: MeshPart, nodes: Mapping[str, NodeValues], format: str) -> None:
    """Write a part to ``path``; ``nodes`` are values at its nodes, or functions of x and y."""
    if format == "npz":
        values: dict[str, Any] = {
            name: found(part.x, part.y) if callable(found) else found for name, found in nodes.items()
        }
        with path.open("wb") as file:
            np.savez(file, x=part.x, y=part.y, **values)
        return
    with TemporaryDirectory(dir=path.parent) as folder:
        head = Path(folder) / PART_FORMATS[format].head_name("mesh")
        os.replace(write_part(head, part, PartData(nodes=nodes), format=format), path)


def write_head_file(path: Path, layout: PartsLayout, format: str) -> None:
    """Write the head to ``path``; it refers to the parts by the name of the layout."""
    with TemporaryDirectory(dir=path.parent) as folder:
        head = Path(folder) / PART_FORMATS[format].head_name(layout.name)
        write_head(head, grid=layout.grid, cuts=layout.firsts[1:], nodes=layout.nodes, format=format, parts_exist=False)
        os.replace(head, path)


@dataclass(frozen=True)
class _Values:
    """The values of a field at nodes."""

    field: Field

    def __call__(self, x: Array, y: Array) -> Array:
        return self.field.evaluate(x, y)[0]


def values_of(u: Field | None) -> dict[str, NodeValues]:
    """The arrays at the nodes of a part: u, where there is one, evaluated for some rows at a time."""
    return {} if u is None else {"u": _Values(u)}


def convert_part_file(source: Path, path: Path, layout: PartsLayout, number: int, format: str) -> None:
    """Write a part in another format; ``source`` is its file as it was written at first."""
    (first, last), n_eta = layout.rows[number], layout.grid.n_eta
    rows, piece = min(last + 1, layout.grid.n_xi) - first, Piece(path=source)
    points = piece.array("Points", "Points", (rows, n_eta, 3))  # mapped, so that little of it is in memory
    part = MeshPart(
        grid=layout.grid,
        number=number,
        count=len(layout.rows),
        first=first,
        last=last,
        x=points[:, :, 0],
        y=points[:, :, 1],
    )
    nodes = {name: piece.array("PointData", name, (rows, n_eta)) for name in layout.nodes}
    write_part_file(path, part, nodes, format)


_log = logging.getLogger(__name__)
# What names a worker or a machine in the sentences of the cluster: callers of the service do not get to know addresses.
_NAMES = (
    (re.compile(r"(the worker )?\b[a-z]+://[^\s,;()]+"), "a worker"),
    (re.compile(r"the machine \S+"), "a machine"),
)


def solve_in_parts(job: Job, spec: BuiltSpec, store: Store, requested: str | None) -> Ending | None:
    """Compute a mesh in parts and store it; returns its end, or None when the attempt was lost meanwhile.

    The files are in the format of all meshes in parts, and in the requested format. Raises a problem where the cluster
    refuses the mesh, and :class:`~equimesh_service.errors.WorkerLostError` where workers with parts, or the
    connection to the scheduler, were lost.
    """
    from equimesh_cluster import ClusterError, NoSchedulerError, PartsError, WorkersLostError

    began = time.perf_counter()
    reporter = Reporter(None, partial(store.queue.progress, job.claim))
    try:
        outcome = _compute(job, spec, reporter, {WRITTEN, requested or WRITTEN})
    except SolveError as error:
        outcome = Outcome(error=_problem(error.solution).body())
    except PartsError as error:
        outcome = Outcome(error=_problem(error.handle).body())
    except WorkersLostError as error:
        raise WorkerLostError(f"workers with parts of the mesh were lost: {error}") from None
    except NoSchedulerError as error:  # the next attempt is on another worker
        raise WorkerLostError(f"a worker lost the cluster: {error}") from None
    except ClusterError as error:
        _log.warning("mesh %s: the cluster refuses it: %s", job.claim.mesh_id, error)
        raise Problem("cluster-refused", f"{_without_addresses(str(error))}.") from None
    if not store.queue.finish(job.claim, outcome):
        return None
    seconds = time.perf_counter() - began
    _log.info("mesh %s %s in parts, after %.3f s", job.claim.mesh_id, outcome.status, seconds)
    reason = "" if outcome.error is None else str(outcome.error["type"]).rpartition("/")[2]
    points = spec.grid_problem.grid.points
    return Ending(status=outcome.status, reason=reason, points=points, solve_seconds=seconds)


def _compute(job: Job, spec: BuiltSpec, reporter: Reporter, formats: set[str]) -> Outcome:
    """The result of a mesh in parts, and its files, which are in the storage."""
    from equimesh_cluster import connect, solve

    began, files = time.perf_counter(), job.storage.files()
    with ExitStack() as stack:
        client = stack.enter_context(connect(job.scheduler))
        with tracing.span("solve"), translate_errors():
            handle = solve(
                spec.grid_problem,
                client,
                parts=None if spec.parts == AUTOMATIC_PARTS else spec.parts,
                mode=spec.mode,
                allow_relaxed=spec.allow_relaxed,
                threads=job.threads,
                observe=reporter.part,
            )
        stack.enter_context(handle)
        solved = time.perf_counter()
        reporter.writing()
        with tracing.span("write"):
            layout = _layout(handle, job.claim.mesh_id)
            artifacts = _write(handle, layout, job.storage, sorted(formats))
            result = {**_describe(handle), "parts": {**layout.record(), "traffic": _traffic(handle)}}
    result["timings"] = {"solve": solved - began, "write": time.perf_counter() - solved}
    return Outcome(result=result, files=artifacts, publish=_PublicationCheck(artifacts, files))


@dataclass(frozen=True)
class _PublicationCheck:
    """Checks that files which workers have published are still there, in the transaction that names them."""

    artifacts: list[Artifact]
    files: Files

    def __call__(self, removed: Removed) -> None:
        for artifact in self.artifacts:
            file = StoredFile(artifact.sha256, artifact.size)
            if removed(file.sha256) and not self.files.holds(file):
                raise FilesError("a file of the mesh was removed before the mesh was finished")


def _layout(handle: Handle, name: str) -> PartsLayout:
    nodes = () if handle.problem.monitor.u is None else ("u",)
    return PartsLayout(name=name, grid=handle.grid, firsts=(0, *handle.cuts), nodes=nodes)


def _write(handle: Handle, layout: PartsLayout, storage: Storage, formats: list[str]) -> list[Artifact]:
    """The files of all parts, which their workers write, and the heads."""
    written = handle.each(write_part_into, storage, formats)
    artifacts = [
        Artifact(part_artifact(format, number), file.sha256, file.size)
        for number, files in enumerate(written)
        for format, file in files.items()
    ]
    files = storage.files()
    for format in formats:
        with files.unfinished(PART_FORMATS[format].head_suffix) as path:
            write_head_file(path, layout, format)
            file = files.seal(path)
            files.publish(path, file, _is_not_removed)
        artifacts.append(Artifact(head_name(format), file.sha256, file.size))
    return artifacts


def write_part_into(_: Any, part: PartSolution, storage: Storage, formats: list[str]) -> dict[str, StoredFile]:
    """Write the files of a part into the storage, where it is; returns them by their formats.

    No row names them yet. Those that none ever names are swept up later, as all such files.
    """
    files, found = storage.files(), {}
    for format in formats:
        with files.unfinished(PART_FORMATS[format].suffix) as path:
            write_part_file(path, part.mesh, values_of(part.problem.monitor.u), format)
            found[format] = files.seal(path)
            files.publish(path, found[format], _is_not_removed)
    return found


def _is_not_removed(_: str) -> bool:
    """Whether content was removed: looked at when the mesh is finished, see :class:`_PublicationCheck`."""
    return False


def _describe(handle: Handle) -> dict[str, Any]:
    """The summary of the solution, with the keys of a mesh that is not in parts."""
    unknown = ("transmission", "work", "max_q_eq", "change", "error", "rate", "predicted_rate")
    solution = {
        "status": str(handle.status),
        "message": handle.message,
        "newton_steps": handle.newton_steps,
        "residual": handle.residual if handle.residual < float("inf") else None,
        "iterations": 0,
        "traffic": sum(sent.bytes for sent in handle.traffic.values()),
        **dict.fromkeys(unknown),
    }
    return {
        "solution": solution,
        "quality": handle.quality().summary(),
        "certificate": handle.certificate.summary(),
    }


def _traffic(handle: Handle) -> dict[str, int]:
    """The bytes of all parts, and the messages of the part that has sent most."""
    messages = [
        sum(sent.messages for record in records for sent in record.traffic.values()) for records in handle.records
    ]
    total = sum(sent.bytes for sent in handle.traffic.values())
    return {"bytes": total, "messages": max(messages, default=0), "attempts": handle.attempts}


def _problem(solution: Solution | Handle) -> Problem:
    detail = solution.note or solution.status.sentence
    return Problem(str(solution.status).replace("_", "-"), detail, remedy=solution.remedy)


def _without_addresses(sentence: str) -> str:
    for name, word in _NAMES:
        sentence = name.sub(word, sentence)
    return sentence
