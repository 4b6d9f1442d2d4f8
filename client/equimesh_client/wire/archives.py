"""XDMF meshes: unpacks the four files of a zip into one folder."""

import io
import zipfile
from pathlib import Path

from equimesh_client.errors import DownloadDamaged
from equimesh_client.wire.files import write_atomically

PARTS = ("mesh", "facets")


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
