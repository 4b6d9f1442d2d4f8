"""Admission: everything that is checked of a request before its mesh may wait in the queue."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass
from hashlib import sha256
from time import time
from typing import Any, TypeVar

import equimesh
from equimesh_service import intake
from equimesh_service.assembly import build_field, build_problem, build_schwarz, pointing
from equimesh_service.engine import Engine, EngineError, MemoryLimitError, TimeLimitError
from equimesh_service.files import FileStore
from equimesh_service.problems import Problem, invalid
from equimesh_service.rows import SamplesRow
from equimesh_service.settings import Settings
from equimesh_service.spec import (
    DomainSpec,
    GridSource,
    MeshSpec,
    ScatteredSource,
    Source,
    StoredSource,
    read_spec,
)
from equimesh_service.store import Store

UPLOAD = "upload"
# Longest that one request may keep a worker busy with its samples.
_WORK_SECONDS = 60.0
Result = TypeVar("Result")


@dataclass(frozen=True)
class Upload:
    """A file as it came: its bytes, and the name whose suffix tells its format."""

    data: bytes
    filename: str


@dataclass(frozen=True)
class Admitted:
    """A spec that will be solved: canonical, with the id of the stored samples that it uses."""

    spec: Mapping[str, Any]
    samples_id: str | None

    def fingerprint(self, format: str | None) -> str:
        """The same for requests that ask for the same."""
        text = json.dumps([self.spec, format], sort_keys=True, allow_nan=False)
        return sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Admission:
    """Checks requests against the settings, and keeps the samples that come with them."""

    settings: Settings
    store: Store
    files: FileStore
    desk: Engine

    def admit(self, document: Any, upload: Upload | None) -> Admitted:
        """Check a parsed spec, and keep its upload; raises a 422 problem with pointers."""
        spec = read_spec(document)
        self._check_limits(spec)
        source = spec.monitor.u
        with_upload = isinstance(source, StoredSource) and source.samples == UPLOAD
        if with_upload and upload is None:
            message = 'send the request as multipart, with parts "spec" and "samples", or give the id of stored samples'
            raise invalid("/monitor/u/samples", message)
        if upload is not None and not with_upload:
            raise invalid("/monitor/u", 'there is a part "samples": refer to it with {"samples": "upload"}')
        # The numbers first: an upload is not kept for a spec that is refused.
        build_problem(spec, self._field(source))
        build_schwarz(spec)
        canonical = spec.canonical()
        if not isinstance(source, StoredSource):
            return Admitted(canonical, None)
        row = self.stored(source.samples) if upload is None else self.keep(upload, "/monitor/u/samples")[0]
        canonical["monitor"]["u"]["samples"] = row.id
        return Admitted(canonical, row.id)

    def stored(self, samples_id: str) -> SamplesRow:
        """Samples that were uploaded before."""
        row = self.store.samples(samples_id)
        if row is None:
            raise invalid("/monitor/u/samples", "there are no samples with this id; POST /v1/samples gives one")
        return row

    def keep(self, upload: Upload, pointer: str) -> tuple[SamplesRow, bool]:
        """Read uploaded samples and keep them; the second value tells whether they are new."""
        most = 4 * self.settings.max_body
        with self.files.unfinished(".upload") as source, self.files.unfinished(".npz") as path:
            source.write_bytes(upload.data)
            summary = self._work(pointer, intake.convert, source, upload.filename, path, most)
            self._check_samples(math.prod(summary["shape"]), pointer)
            file = self.files.seal(path)
            row = SamplesRow(f"s-{file.sha256[:32]}", file.sha256, file.size, summary, time())
            new = self.store.add_samples(row, lambda: self.files.publish(path, file))
        return (row, True) if new else (self.stored(row.id), False)

    def _field(self, source: Source) -> equimesh.Field:
        """u as the spec has it; for samples that take long to interpolate, something in its place."""
        if isinstance(source, ScatteredSource):
            given = source.scattered
            self._work("/monitor/u/scattered", intake.check_scattered, given.points, given.values)
        elif not isinstance(source, StoredSource):
            return build_field(source)
        return equimesh.Expression("0")

    def _work(self, pointer: str, function: Callable[..., Result], *arguments: Any) -> Result:
        """Have a worker do it, within a time; what it refuses becomes a 422 problem."""
        try:
            with pointing(pointer):
                return self.desk.submit(function, *arguments, time_limit=_WORK_SECONDS).result()
        except (TimeLimitError, MemoryLimitError) as error:
            message = f"the samples are too many to interpolate ({error}): send fewer, or send them on a grid"
            raise invalid(pointer, message) from None
        except (EngineError, CancelledError) as error:
            raise Problem("unavailable", f"The samples were not read: {error}.") from None

    def _check_limits(self, spec: MeshSpec) -> None:
        most = self.settings
        if [spec.domain.x, spec.domain.y] != [DomainSpec().x, DomainSpec().y]:
            raise invalid("/domain", "this version meshes the unit square only: x and y must be [0, 1]")
        # One direction at a time as well: an absurd number is told as such, whatever the other one is.
        for name, points in (("n_xi", spec.grid.n_xi), ("n_eta", spec.grid.n_eta)):
            if points > most.max_points // 4:
                message = f"too many points: a mesh of this service has at most {most.max_points} in all"
                raise invalid(f"/grid/{name}", message)
        points = spec.grid.n_xi * spec.grid.n_eta
        if spec.grid.n_xi > 0 and points > most.max_points:
            message = f"{points} points; a mesh of this service has at most {most.max_points}: lower n_xi or n_eta"
            raise invalid("/grid", message)
        source = spec.monitor.u
        if isinstance(source, GridSource):
            self._check_samples(sum(map(len, source.grid.values)), "/monitor/u/grid/values")
        elif isinstance(source, ScatteredSource):
            self._check_samples(len(source.scattered.points), "/monitor/u/scattered/points")
        if spec.schwarz is not None:
            along_xi, along_eta = spec.schwarz.subdomains
            if max(along_xi, along_eta) > most.max_subdomains or along_xi * along_eta > most.max_subdomains:
                message = f"too many: this service takes at most {most.max_subdomains} subdomains in all"
                raise invalid("/schwarz/subdomains", message)
            if spec.schwarz.overlap > max(spec.grid.n_xi, spec.grid.n_eta):
                message = "the overlap is larger than the grid: 2 to 8 points are usual"
                raise invalid("/schwarz/overlap", message)
            if spec.schwarz.max_iterations > most.max_iterations:
                message = f"too many: this service runs at most {most.max_iterations} iterations"
                raise invalid("/schwarz/max_iterations", message)

    def _check_samples(self, number: int, pointer: str) -> None:
        if number > self.settings.max_samples:
            message = f"{number} samples; this service takes at most {self.settings.max_samples}: send fewer"
            raise invalid(pointer, message)
