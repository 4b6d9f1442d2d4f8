"""The HTTP interface as plain functions, which build requests and read answers; nothing is sent here."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from equimesh_client.errors import BadArgument, InputProblem, ProblemError, ServiceUnreachable, error_class
from equimesh_client.spec.request import MeshRequest
from equimesh_client.spec.sources import Upload
from equimesh_client.wire.settings import retry_after_of
from equimesh_client.wire.stream import StreamPosition
from equimesh_coupling.samples import Box
from equimesh_schema import Certificate
from equimesh_schema.mesh import SUFFIXES as MESH_SUFFIXES

SUFFIXES: Mapping[str, str] = {**MESH_SUFFIXES, ".zip": "xdmf"}
PART_SUFFIXES: Mapping[str, str] = {".pvtu": "pvtu", ".vtkhdf": "vtkhdf"}  # heads of meshes in parts
NPZ = "application/x-npz"
# Seconds for which a service may compute a mesh that it does not keep, by its default.
_COMPUTE_SECONDS = 30.0
PLOTS: Mapping[str, str] = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True, kw_only=True)
class Call:
    """One request.

    ``body`` is complete, so that a repeated call sends the same bytes. ``sent`` is the JSON in it, which error messages
    quote. ``patience`` is the time in seconds for which the service may hold its answer back.
    """

    method: str
    path: str
    query: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    body: bytes | None = None
    sent: Any = None
    patience: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Reply:
    """One answer: status, headers with lower-case names, the body (empty when it went into a file)."""

    status: int
    headers: Mapping[str, str]
    body: bytes = b""


def create_mesh(mesh_request: MeshRequest, *, wait: int) -> Call:
    """Request a mesh. The service may hold its answer back for ``wait`` seconds, until the mesh is finished."""
    headers = {"Accept": "application/json", "Idempotency-Key": mesh_request.key}
    if wait:
        headers["Prefer"] = f"wait={wait}"
    body = json_bytes(mesh_request.spec)
    files = {"samples": mesh_request.uploads[0]} if mesh_request.uploads else {}
    files |= {} if mesh_request.mesh is None else {"mesh": mesh_request.mesh}
    if files:
        part = Upload(filename="", data=body, media_type="application/json")
        headers["Content-Type"], body = multipart({"spec": part, **files})
    else:
        headers["Content-Type"] = "application/json"
    return Call(
        method="POST",
        path="/v1/meshes",
        query={} if mesh_request.reuse else {"reuse": "false"},
        headers=headers,
        body=body,
        sent=dict(mesh_request.spec),
        patience=float(wait),
    )


def compute_mesh(mesh_request: MeshRequest, format: str = "npz") -> Call:
    """Request the file of a mesh that the service does not keep."""
    call = create_mesh(mesh_request, wait=0)
    headers = {**call.headers, "Accept": f"{NPZ}, application/json" if format == "npz" else "*/*"}
    del headers["Idempotency-Key"]
    return replace(call, query={"store": "false", "format": format}, headers=headers, patience=_COMPUTE_SECONDS)


def create_sequence(mesh_request: MeshRequest, *, wait: int, keep: int) -> Call:
    """Begin a sequence with a mesh; the service keeps the last ``keep`` meshes of the sequence."""
    return replace(create_mesh(mesh_request, wait=wait), path="/v1/sequences", query={"keep": str(keep)})


def sequence(sequence_id: str, *, method: str = "GET") -> Call:
    """Look up or delete a sequence."""
    return Call(method=method, path=_sequence(sequence_id), headers={"Accept": "application/json"})


def list_sequences(*, limit: int, cursor: str | None) -> Call:
    """One page of the list of sequences."""
    return _get("/v1/sequences", query={"limit": str(limit), **({} if cursor is None else {"cursor": cursor})})


def create_step(sequence_id: str, body: bytes, media_type: str, *, sent: Any = None) -> Call:
    """Take a step of a sequence; the answer is its mesh as npz."""
    key = hashlib.sha256(sequence_id.encode() + b" " + body).hexdigest()
    headers = {"Accept": NPZ, "Content-Type": media_type, "Idempotency-Key": key}
    path = f"{_sequence(sequence_id)}/steps"
    return Call(method="POST", path=path, headers=headers, body=body, sent=sent)


def list_meshes(*, status: str | None, label: str | None, limit: int, cursor: str | None) -> Call:
    """One page of the list of meshes."""
    query = {"status": status, "label": label, "limit": str(limit), "cursor": cursor}
    return _get("/v1/meshes", query={key: value for key, value in query.items() if value is not None})


def get_mesh(mesh_id: str, *, wait: int = 0) -> Call:
    """One mesh; with ``wait`` the answer comes when it is finished, or after this many seconds."""
    return _get(_mesh(mesh_id), query={"wait": str(wait)} if wait else {}, patience=float(wait))


def events(mesh_id: str, position: StreamPosition) -> Call:
    """The stream of events after ``position``."""
    headers = {"Accept": "text/event-stream", "Cache-Control": "no-store", **position.headers}
    return Call(method="GET", path=_mesh(mesh_id, "events"), headers=headers)


def cancel_mesh(mesh_id: str) -> Call:
    """Cancel a mesh."""
    return Call(method="POST", path=_mesh(mesh_id, "cancel"), headers={"Accept": "application/json"})


def delete_mesh(mesh_id: str) -> Call:
    """Delete a mesh and its files."""
    return Call(method="DELETE", path=_mesh(mesh_id))


def mesh_file(mesh_id: str, format: str, *, cells: str | None = None, order: int = 1, partial: bool = False) -> Call:
    """The mesh as a file; ``cells`` overrides the cells of the spec."""
    query = {"format": format}
    if order != 1:
        query["order"] = str(order)
    if cells is not None:
        query["cells"] = cells
    if partial:
        query["partial"] = "true"
    # not compressed by a proxy: parts of a compressed file cannot be joined
    headers = {"Accept": "*/*", "Accept-Encoding": "identity"}
    return Call(method="GET", path=_mesh(mesh_id, "file"), query=query, headers=headers)


def parts_manifest(mesh_id: str, format: str) -> Call:
    """The list of the files of a mesh in parts."""
    return _get(_mesh(mesh_id, "parts"), query={"format": format})


def part_file(mesh_id: str, number: int, format: str) -> Call:
    """The file of a part of a mesh."""
    headers = {"Accept": "*/*", "Accept-Encoding": "identity"}
    return Call(method="GET", path=_mesh(mesh_id, f"parts/{number}"), query={"format": format}, headers=headers)


def mesh_part(mesh_id: str, part: str, **query: str) -> Call:
    """``quality``, ``convergence`` or ``spec`` of a mesh."""
    return _get(_mesh(mesh_id, part), query=query)


def mesh_drawing(mesh_id: str) -> Call:
    """What is needed to draw a mesh: an npz with the error of every cell."""
    headers = {"Accept": "application/x-npz, application/octet-stream, */*", "Accept-Encoding": "identity"}
    return Call(method="GET", path=_mesh(mesh_id, "drawing"), query={}, headers=headers)


def mesh_plot(mesh_id: str, kind: str, format: str) -> Call:
    """A picture of a mesh. Raises :class:`BadArgument` for a format other than svg and png."""
    if format not in PLOTS:
        raise BadArgument(f"plots are svg or png, not {format!r}")
    return Call(
        method="GET",
        path=_mesh(mesh_id, "plot"),
        query={"kind": kind, "format": format},
        headers={"Accept": PLOTS[format]},
    )


def upload_samples(upload: Upload) -> Call:
    """Store samples once, for any number of meshes."""
    query = {} if upload.column is None else {"column": upload.column}
    content_type, body = multipart({"samples": upload})
    headers = {"Accept": "application/json", "Content-Type": content_type}
    return Call(method="POST", path="/v1/samples", headers=headers, body=body, query=query)


def upload_mesh(upload: Upload) -> Call:
    """Store a mesh file once, as the domain of any number of meshes."""
    return replace(upload_samples(upload), query={"kind": "mesh"})


def stored_samples(samples_id: str, *, method: str = "GET") -> Call:
    """Look up or delete stored samples."""
    return Call(method=method, path=f"/v1/samples/{quote(samples_id, safe='')}", headers={"Accept": "application/json"})


def check_expression(
    expression: str, parameters: Mapping[str, float] | None, t: float | None, domain: Mapping[str, Any] | None = None
) -> Call:
    """Parse and evaluate an expression on ``domain``, by default the unit square."""
    sent: dict[str, Any] = {"expression": expression}
    if parameters:
        sent["parameters"] = dict(parameters)
    if t is not None:
        sent["t"] = t
    if domain is not None:
        sent["domain"] = dict(domain)
    headers = {"Accept": "application/json", "Content-Type": "application/json"}
    return Call(method="POST", path="/v1/expressions/check", headers=headers, body=json_bytes(sent), sent=sent)


def capabilities() -> Call:
    """The capabilities of the service."""
    return _get("/v1/capabilities")


def json_bytes(value: object) -> bytes:
    """JSON bytes. Raises :class:`BadArgument` for values that JSON does not have (NaN, infinity, foreign objects)."""
    try:
        return json.dumps(value, allow_nan=False, default=_plain).encode()
    except (TypeError, ValueError) as error:
        place = None if "Circular" in str(error) else _not_finite(value, "")
        reason = f"{place} is NaN or infinite, as from a solver that diverged" if place else error
        raise BadArgument(f"the request cannot be written as JSON: {reason}") from error


def _not_finite(value: Any, place: str) -> str | None:
    """The place of the first number that is not finite, as /a/0/1; None where there is none."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float):
        return None if math.isfinite(value) else place
    parts = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else ()
    return next((found for name, part in parts if (found := _not_finite(part, f"{place}/{name}")) is not None), None)


def _plain(value: Any) -> Any:
    """The number or list of a scalar or array of numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} is no JSON value")


def multipart(parts: Mapping[str, Upload]) -> tuple[str, bytes]:
    """Content type and body of ``multipart/form-data``. The same parts give the same bytes."""
    boundary = "equimesh-" + hashlib.sha256(b"\0".join(part.data for part in parts.values())).hexdigest()[:40]
    lines: list[bytes] = []
    for name, part in parts.items():
        disposition = f'Content-Disposition: form-data; name="{name}"'
        if part.filename:
            safe = part.filename.replace("\\", "_").replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
            disposition += f'; filename="{safe}"'
        head = ["--" + boundary, disposition, f"Content-Type: {part.media_type}", ""]
        lines += [*(line.encode() for line in head), part.data]
    lines += [b"--" + boundary.encode() + b"--", b""]
    return f"multipart/form-data; boundary={boundary}", b"\r\n".join(lines)


def _object(text: str | bytes) -> dict[str, Any] | None:
    """The JSON object of a text; None for any other text."""
    try:
        value = json.loads(text)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


def json_of(reply: Reply) -> dict[str, Any]:
    """The JSON object of an answer; raises :class:`ServiceUnreachable` for the answer of another program."""
    value = _object(reply.body)
    if value is None:
        kind = reply.headers.get("content-type", "no content type")
        raise ServiceUnreachable(
            f"the answer (HTTP {reply.status}, {kind}) is not one of an equimesh service; check the URL"
        )
    return value


def certificate_of(reply: Reply) -> Certificate | None:
    """The certificate that came with a file; None without one, as from another service."""
    found = _object(reply.headers.get("equimesh-certificate", ""))
    return None if found is None else Certificate.from_json(found)


def mesh_of(reply: Reply) -> dict[str, Any]:
    """The mesh resource of an answer; its id may come from the ``Location`` header."""
    record = json_of(reply)
    if "id" not in record:
        found = re.search(r"/v1/meshes/([^/?#]+)", reply.headers.get("location", ""))
        if found is None:
            raise ServiceUnreachable("the answer holds no mesh; check that the URL is that of an equimesh service")
        record["id"] = unquote(found.group(1))
    return record


def box_of(reply: Reply) -> Box:
    """The box of the domain in the answer to a check of an expression."""
    try:
        (x0, x1), (y0, y1) = json_of(reply)["domain"]["box"]
        return (float(x0), float(x1)), (float(y0), float(y1))
    except (KeyError, TypeError, ValueError):
        raise ServiceUnreachable(
            "the answer names no box of a domain; the service may be too old for domains"
        ) from None


def raise_for_status(reply: Reply, call: Call) -> Reply:
    """The reply itself if it is a success; otherwise raises its :class:`ProblemError`."""
    if 200 <= reply.status < 300:
        return reply
    raise problem_of(reply, call)


def problem_of(reply: Reply, call: Call) -> ProblemError:
    """The exception for an unsuccessful answer with any body."""
    document = _object(reply.body) or {}
    phrase = next((s.phrase for s in HTTPStatus if s.value == reply.status), "unexpected answer")
    detail = document.get("detail", "")
    if not detail and 300 <= reply.status < 400:
        detail = f"the service has another address: {reply.headers.get('location', 'not named')}"
    kind = str(document.get("type", "about:blank"))
    return error_class(reply.status, kind)(
        status=reply.status,
        type=kind,
        title=str(document.get("title") or phrase),
        detail=detail if isinstance(detail, str) else json.dumps(detail),
        errors=[_input_problem(error, call.sent) for error in _objects(document.get("errors"))],
        problem=document,
        retry_after=retry_after_of(reply.headers),
    )


def _objects(value: Any) -> Sequence[Mapping[str, Any]]:
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _input_problem(error: Mapping[str, Any], sent: Any) -> InputProblem:
    pointer = str(error.get("pointer") or error.get("parameter") or "")
    position = error.get("position")
    place = position if isinstance(position, dict) else {}
    text = at_pointer(sent, pointer) if place else None
    line, column = place.get("line"), place.get("column")
    columns = error.get("columns")
    return InputProblem(
        pointer=pointer,
        message=str(error.get("message", "")),
        line=line if isinstance(line, int) else None,
        column=column if isinstance(column, int) else None,
        text=text if isinstance(text, str) else None,
        columns=tuple(map(str, columns)) if isinstance(columns, list) else (),
    )


def at_pointer(document: Any, pointer: str) -> Any:
    """The value at a JSON pointer (RFC 6901), or None."""
    value = document
    for token in pointer.removeprefix("#").split("/")[1:]:
        key = unquote(token).replace("~1", "/").replace("~0", "~")
        if isinstance(value, dict) and key in value:
            value = value[key]
        elif isinstance(value, list) and key.isdigit() and int(key) < len(value):
            value = value[int(key)]
        else:
            return None
    return value


def sha256_of(headers: Mapping[str, str]) -> str | None:
    """The sha256 in the ETag of a file, or None."""
    found = re.search(r"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])", headers.get("etag", "").lower())
    return found.group() if found else None


def continues(reply: Reply, sha256: str | None, start: int) -> bool:
    """Whether a 206 continues the file with this sha256 after its first ``start`` bytes."""
    found = re.match(r"bytes (\d+)-\d+/", reply.headers.get("content-range", ""))
    return found is not None and int(found[1]) == start and resumable(reply) and sha256_of(reply.headers) == sha256


def resumable(reply: Reply) -> bool:
    """Whether the rest of this file can be requested later: a strong ETag identifies its bytes."""
    plain = reply.headers.get("content-encoding", "identity") == "identity"
    return plain and reply.headers.get("etag", "").startswith('"') and sha256_of(reply.headers) is not None


def format_of(path: str, format: str | None = None) -> str:
    """The mesh format: ``format`` itself, or that of the suffix of ``path``; for a folder that exists, ``foam``.

    Raises :class:`BadArgument` for a suffix of no format.
    """
    if format is not None:
        return format
    if Path(path).is_dir():
        return "foam"
    for suffix, name in SUFFIXES.items():
        if path.lower().endswith(suffix):
            return name
    raise BadArgument(f"{path}: the suffix names no mesh format; use {', '.join(SUFFIXES)}, or give the format")


def _sequence(sequence_id: str) -> str:
    return f"/v1/sequences/{quote(sequence_id, safe='')}"


def _mesh(mesh_id: str, part: str = "") -> str:
    if not isinstance(mesh_id, str):
        raise BadArgument(f"the id of a mesh is a text, such as mesh.id; not {mesh_id!r:.80}")
    if not mesh_id:
        raise BadArgument("the id of a mesh is empty")
    return f"/v1/meshes/{quote(mesh_id, safe='')}" + (f"/{part}" if part else "")


def _get(path: str, *, query: Mapping[str, str] | None = None, patience: float = 0.0) -> Call:
    return Call(method="GET", path=path, query=query or {}, headers={"Accept": "application/json"}, patience=patience)


PAGE_RECORDS = 100
"""Records in one page of a list."""


class Pages:
    """The list of meshes, page by page: at most ``limit`` records in all; None for no limit.

    Lists of other things replace :meth:`call`.
    """

    def __init__(self, *, status: str | None, label: str | None, limit: int | None) -> None:
        self._status, self._label, self._left = status, label, limit
        self._cursor: str | None = None
        self.more = limit is None or limit > 0

    def next_call(self) -> Call:
        """The request for the next page."""
        return self.call(PAGE_RECORDS if self._left is None else min(self._left, PAGE_RECORDS), self._cursor)

    def call(self, size: int, cursor: str | None) -> Call:
        """The request for a page of ``size`` records after a ``cursor``."""
        return list_meshes(status=self._status, label=self._label, cursor=cursor, limit=size)

    def records(self, page: Mapping[str, Any]) -> list[dict[str, Any]]:
        """The records of a fetched page, up to the limit of the list."""
        records = list(page.get("items") or [])[: self._left]
        self._cursor = page.get("next_cursor")
        self._left = None if self._left is None else self._left - len(records)
        self.more = self._cursor is not None and (self._left is None or self._left > 0)
        return records


class SequencePages(Pages):
    """The list of sequences, page by page."""

    def __init__(self, *, limit: int | None) -> None:
        super().__init__(status=None, label=None, limit=limit)

    def call(self, size: int, cursor: str | None) -> Call:
        """The request for a page of ``size`` records after a ``cursor``."""
        return list_sequences(limit=size, cursor=cursor)
