"""Downloads of meshes in parts: all files of one, or the arrays of a part."""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.sax.saxutils import quoteattr

import numpy as np

from equimesh_client.errors import BadArgument, DownloadDamaged, ServiceUnreachable
from equimesh_client.records.measures import Array
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.downloads import PartFile, write_atomically
from equimesh_client.wire.flows import Flow
from equimesh_client.wire.protocol import Call
from equimesh_client.wire.settings import Deadline, Settings
from equimesh_schema.answers import FileOfParts, Parts

DEFAULT_FORMAT = "pvtu"
"""The format in which the service writes a mesh in parts."""
TEXT = "pvtu"
"""The format whose head is a text, with the names of the parts."""
PIECE_BYTES = 2**20
"""Bytes of a file that are read at once, for its checksum."""
MAX_DEPTH = 2
"""Files are next to the head, or in a folder there."""
PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,199}", re.ASCII)
"""The name of a file or a folder."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartArrays:
    """The arrays of part ``number`` of a mesh, whose own rows are ``first`` to ``last - 1``.

    ``x``, ``y`` and ``u`` have the shape ``(rows, n_eta)``, with the first row of the next part where there is one.
    ``u`` is None where the monitor has none.
    """

    number: int
    first: int
    last: int
    x: Array
    y: Array
    u: Array | None


def is_of_parts(path: str | Path, format: str | None) -> bool:
    """Whether a download to ``path`` is one of a mesh in parts, by its format or by its suffix."""
    if format is not None:
        return format in protocol.PART_SUFFIXES.values()
    return str(path).lower().endswith(tuple(protocol.PART_SUFFIXES))


def download(mesh_id: str, path: str | Path, format: str | None, settings: Settings, deadline: Deadline) -> Flow[Path]:
    """Write the head to ``path``, and the parts below it; returns the path. The format follows from the suffix.

    The parts of ``mesh.pvtu`` are in the folder ``mesh``, to which its head refers then. A head of another format
    refers to a folder with the id of the mesh.
    """
    path = Path(path)
    if format is None:
        format = next(name for suffix, name in protocol.PART_SUFFIXES.items() if str(path).lower().endswith(suffix))
    if format != TEXT:
        return (yield from download_parts(mesh_id, path.parent, format, settings, deadline, head=path.name))
    listed = yield from _listed(mesh_id, path.parent, format, settings, deadline)
    for part in listed.parts:
        target = _below(path.parent, part.file.name, folder=path.stem)
        yield from _save(protocol.part_file(mesh_id, part.number, format), target, part.file, settings, deadline)
    head = yield from flows.fetch_file(protocol.mesh_file(mesh_id, format), settings, deadline)
    for part in listed.parts:
        own = f"{path.stem}/{PurePosixPath(part.file.name).name}"
        head = head.replace(f"{quoteattr(part.file.name)}".encode(), quoteattr(own).encode())
    return write_atomically(path, head)


def manifest(mesh_id: str, format: str, settings: Settings, deadline: Deadline) -> Flow[Parts]:
    """The list of all files of a mesh in parts. Raises :class:`ServiceUnreachable` for what is no such list."""
    record = yield from flows.fetch(protocol.parts_manifest(mesh_id, format), settings, deadline)
    try:
        return Parts.from_json(record)
    except (KeyError, TypeError, ValueError) as error:
        raise ServiceUnreachable(f"the answer lists no parts of a mesh: {error!r}") from None


def download_parts(
    mesh_id: str,
    folder: str | Path,
    format: str,
    settings: Settings,
    deadline: Deadline,
    *,
    head: str | None = None,
) -> Flow[Path]:
    """Write all files into a ``folder`` that exists, the head last, as ``head`` where that is given; returns its path.

    Every file is checked against its checksum. Files that are there already, with the right one, are not sent again.
    Raises :class:`BadArgument` without such a folder, and for a format without a head.
    """
    folder = Path(folder)
    listed = yield from _listed(mesh_id, folder, format, settings, deadline)
    assert listed.head is not None
    for part in listed.parts:
        call = protocol.part_file(mesh_id, part.number, format)
        yield from _save(call, _below(folder, part.file.name), part.file, settings, deadline)
    path = folder / head if head is not None else _below(folder, listed.head.name)
    yield from _save(protocol.mesh_file(mesh_id, format), path, listed.head, settings, deadline)
    return path


def _listed(mesh_id: str, folder: Path, format: str, settings: Settings, deadline: Deadline) -> Flow[Parts]:
    """The list of files that are to be written into ``folder``, with a head."""
    if not folder.is_dir():
        raise BadArgument(f"{folder}: there is no such folder")
    listed = yield from manifest(mesh_id, format, settings, deadline)
    if listed.head is None:
        raise BadArgument(f"a mesh in parts has no head in the format {format}: take {DEFAULT_FORMAT}")
    return listed


def arrays_of_part(mesh_id: str, number: int, settings: Settings, deadline: Deadline) -> Flow[PartArrays]:
    """The arrays of a part. Raises :class:`BadArgument` for a number that no part has."""
    listed = yield from manifest(mesh_id, "npz", settings, deadline)
    if not 0 <= number < listed.count:
        raise BadArgument(f"the mesh has {listed.count} parts, with the numbers 0 to {listed.count - 1}, not {number}")
    part = listed.parts[number]
    body = yield from flows.fetch_file(protocol.part_file(mesh_id, number, "npz"), settings, deadline)
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as file:
            return PartArrays(
                number=number, first=part.first, last=part.last, x=file["x"], y=file["y"], u=file.get("u")
            )
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise DownloadDamaged(f"the npz file of the part cannot be read: {error}") from error


def _save(call: Call, path: Path, file: FileOfParts, settings: Settings, deadline: Deadline) -> Flow[None]:
    """Download a file of the manifest, unless it is there already."""
    if file.sha256 is not None and _is_there(path, file):
        return
    with PartFile(path) as part:
        yield from flows.save(call, settings, deadline, part)
        if file.sha256 is not None and part.sha256 not in (None, file.sha256):
            path.unlink(missing_ok=True)
            raise DownloadDamaged(f"{path.name} does not have the checksum of the list of parts")


def _is_there(path: Path, file: FileOfParts) -> bool:
    if not path.is_file() or path.stat().st_size != file.size:
        return False
    digest = hashlib.sha256()
    with path.open("rb") as content:
        while piece := content.read(PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest() == file.sha256


def _below(place: Path, name: str, *, folder: str | None = None) -> Path:
    """The file of a ``name`` such as ``mesh/part-0000.vts`` at a ``place``, whose own folder is made.

    ``folder`` is the name of that folder, in place of its own one. Raises :class:`DownloadDamaged` for a name that
    leads elsewhere.
    """
    parts = name.split("/")
    if not 1 <= len(parts) <= MAX_DEPTH or not all(PLAIN.fullmatch(part) for part in parts):
        raise DownloadDamaged(f"{name!r:.80} is not the name of a file of a mesh")
    path = place.joinpath(*parts) if folder is None else place / folder / parts[-1]
    path.parent.mkdir(exist_ok=True)
    return path
