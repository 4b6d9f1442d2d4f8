"""The answer to a request that may wait for its mesh."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from fastapi import Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.responses import Response

from equimesh_service.admission.callers import Caller
from equimesh_service.admission.formats import known_format
from equimesh_service.admission.intake import AcceptedMesh
from equimesh_service.api.mesh_files import MEDIA_TYPES, check_done, mesh_bytes, mesh_file
from equimesh_service.service import Service
from equimesh_service.store.rows import MeshRow
from equimesh_service.telemetry import stopwatch
from equimesh_service.wire.negotiation import choose_explicit_offer, parse_wait
from equimesh_service.worker.names import file_name


@dataclass(frozen=True)
class Waiting:
    """The form and the time of an answer: a file in ``format``, or JSON for None, after at most ``seconds``.

    ``wanted`` is the wait of the header Prefer in seconds, None without the header.
    """

    format: str | None
    seconds: int
    wanted: int | None

    @classmethod
    def of(cls, request: Request, service: Service, format: str | None, prefer: str | None) -> Waiting:
        """Read ?format=, Accept and Prefer; raises a 406 problem."""
        name = known_format(format) if format is not None else None
        wanted = parse_wait(prefer)
        return cls(
            name or choose_explicit_offer(request.headers.get("accept"), MEDIA_TYPES),
            min(wanted or 0, int(service.settings.max_wait)),
            wanted,
        )

    async def answer(
        self,
        request: Request,
        service: Service,
        caller: Caller,
        accepted: AcceptedMesh,
        cells: str,
        headers: dict[str, str],
        describe: Callable[[MeshRow], Awaitable[BaseModel]],
    ) -> Response:
        """Wait for the mesh, and answer with its file or with the resource that ``describe`` makes of its row."""
        if self.wanted is not None:
            headers["Preference-Applied"] = f"wait={self.seconds}"
        began, name = time.monotonic(), self.format
        ending = await service.intake.wait_for_ending(accepted, self.seconds)
        if ending is not None:
            stopwatch.include(ending.laps)
            stopwatch.lap("hand-over")
        if ending is not None and name is not None and (file := ending.file(file_name(name, cells))):
            content = ending.content
            return await mesh_bytes(
                request, service, accepted.mesh_id, name, file, headers=headers, status=201, content=content
            )
        row = await service.wait_for_end(accepted.mesh_id, self.seconds - (time.monotonic() - began), caller)
        if row.reused_from is not None:
            headers["Equimesh-Reused"] = row.reused_from
        if row.finished and name is not None:
            check_done(row, partial=False, headers=headers)
            return await mesh_file(request, service, row, name, row.cells, headers=headers, status=201)
        if not row.finished:
            headers["Retry-After"] = "1"
        resource = await describe(row)
        return JSONResponse(resource.model_dump(mode="json", by_alias=True), 201 if row.finished else 202, headers)
