"""Meshes of several files: unpacks the zip of an XDMF mesh, or of an OpenFOAM mesh, into a folder."""

import io
import zipfile
from pathlib import Path

from equimesh_client.errors import DownloadDamaged
from equimesh_client.wire.files import write_atomically

PARTS = ("mesh", "facets")
# The files of an OpenFOAM mesh, below the folder of a case; the one that the others are numbered by comes last.
FOAM_FILES = tuple(f"constant/polyMesh/{name}" for name in ("boundary", "neighbour", "owner", "faces", "points"))


def unpack_foam(data: bytes, case: str | Path) -> Path:
    """Write the files of a zipped OpenFOAM mesh into ``constant/polyMesh`` of a case, and return its folder.

    Other files of the case stay. Raises :class:`DownloadDamaged` when the zip does not hold these files.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            contents = {name: archive.read(name) for name in FOAM_FILES}
    except (zipfile.BadZipFile, KeyError) as error:
        raise DownloadDamaged(f"the OpenFOAM archive cannot be read: {error}") from error
    for name, content in contents.items():
        path = Path(case) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    return Path(case)


def unpack_xdmf(data: bytes, path: str | Path) -> Path:
    """Write the four files of a zipped XDMF mesh and return ``path``, the one to open.

    ``m.xdmf`` comes with ``m.h5``, ``m_facets.xdmf`` and ``m_facets.h5``. Data is written before the files that refer
    to it. Raises :class:`DownloadDamaged` when the zip does not hold these files.
    """
    path = Path(path)
    names = {"mesh": path.stem, "facets": f"{path.stem}_facets"}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            heavy = {part: archive.read(f"{part}.h5") for part in PARTS}
            light = {part: archive.read(f"{part}.xdmf").decode() for part in PARTS}
    except (zipfile.BadZipFile, KeyError, UnicodeDecodeError) as error:
        raise DownloadDamaged(f"the XDMF archive cannot be read: {error}") from error
    for part in PARTS:
        write_atomically(path.with_name(f"{names[part]}.h5"), heavy[part])
    for part in reversed(PARTS):
        text = light[part].replace(f"{part}.h5:", f"{names[part]}.h5:")
        write_atomically(path.with_name(f"{names[part]}.xdmf"), text.encode())
    return path
