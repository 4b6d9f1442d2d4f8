"""Meshes, and descriptions of domains, from files by their suffix."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from equimesh.errors import InputError
from equimesh.io.reading import foam
from equimesh.io.reading.block_mesh_dict import read_block_mesh_dict
from equimesh.io.reading.bounds import bad_file, most_unpacked, open_zip, refusing
from equimesh.io.reading.foam import read_poly_mesh
from equimesh.io.reading.msh import read_msh
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.structured import read_cgns, read_plot3d
from equimesh.io.reading.su2 import read_su2
from equimesh.io.reading.vtk import read_vtm, read_vtu

# Descriptions of blocks from files: their JSON, and OpenFOAM's blockMeshDict.

# The members and entries of a JSON, at most; a description of a million points of curves has two million.
MAX_VALUES: Final = 3_000_000
# The name of the file, and of the format, of OpenFOAM.
BLOCK_MESH_DICT: Final = "blockMeshDict"


def _read_json(text: str) -> dict[str, Any]:
    """The object of a JSON text."""
    if text.count(",") + text.count(":") > MAX_VALUES:
        raise bad_file(f"the JSON has more than {MAX_VALUES} values: no description needs them")
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise bad_file(f"line {error.lineno}: {error.msg}: this is no JSON") from error
    except (ValueError, RecursionError) as error:
        raise bad_file(f"the JSON cannot be read: {str(error)[:200]}") from error
    if not isinstance(document, dict):
        raise bad_file("the JSON is no object: a description has vertices, blocks and sides")
    return document


# The reader of each format of descriptions.
DESCRIPTIONS: Final[dict[str, Callable[[str], dict[str, Any]]]] = {
    "json": _read_json,
    BLOCK_MESH_DICT: read_block_mesh_dict,
}


def description_format(path: str | os.PathLike[str]) -> str | None:
    """The format of a description by the name of its file, ``None`` for other files.

    A folder with ``system/blockMeshDict`` and without a mesh is none: name the file.
    """
    name = Path(path).name
    return "json" if name.lower().endswith(".json") else BLOCK_MESH_DICT if name.startswith(BLOCK_MESH_DICT) else None


def read_description(path: str | os.PathLike[str], format: str) -> dict[str, Any]:
    """The description in a file, as the object of its JSON; ``format`` is a name of ``DESCRIPTIONS``.

    Raises :class:`~equimesh.errors.InputError` for a file that cannot be read, with the line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{Path(path).name} cannot be read: {error.strerror}", field="path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{Path(path).name} is no text in UTF-8", field="path") from error
    _require_content(text)
    with refusing(format):
        return DESCRIPTIONS[format](text)


def _require_content(content: str | bytes) -> None:
    """Refuse an empty file before a reader misses the first thing that its format needs."""
    if not content.strip():
        raise bad_file("the file is empty: give one that holds a mesh or a description of blocks")


# The reader of each format of meshes; ``zip`` is a zip of the files of a polyMesh, of Plot3D with its map, or
# of a vtm with its grids.
READERS: Final[dict[str, Callable[[bytes], PlainMesh]]] = {
    "msh": read_msh,
    "vtu": read_vtu,
    "su2": read_su2,
    "p3d": read_plot3d,
    "cgns": read_cgns,
    "zip": lambda data: _packed(data),
}
# The format of a file by the suffix of its name.
FORMAT_OF: Final = {
    ".msh": "msh", ".vtu": "vtu", ".su2": "su2", ".p3d": "p3d", ".xyz": "p3d", ".x": "p3d", ".cgns": "cgns",
    ".zip": "zip",
}  # fmt: skip
# The suffixes of Plot3D inside a zip, and of the map next to it.
PLOT3D: Final = (".p3d", ".xyz", ".x")
MAP: Final = ".nmf"
# The suffixes of the head and of the grids of VTK's files of several blocks.
VTM: Final = ".vtm"
VTS: Final = ".vts"
# The most files of a zip: a vtm has one for each block.
MAX_MEMBERS: Final = 20_000
# Where an OpenFOAM case has its mesh.
POLY_MESH: Final = Path("constant") / "polyMesh"


def read_mesh(path: str | os.PathLike[str], format: str | None = None) -> PlainMesh:
    """The mesh of a file, or of a folder with a ``polyMesh``: itself, ``constant``, or the case.

    ``format`` is a name of ``READERS``; by default the suffix tells it. A Plot3D file takes the names of its sides from
    a neutral map next to it, of the same name with the suffix ``.nmf``. A ``.vtm`` file is read with the grids that it
    names. Raises :class:`~equimesh.errors.InputError` for
    an unknown format, for a file that cannot be read, and for a mesh that is not one of quadrilaterals in a plane.
    """
    source = Path(path)
    if source.is_dir():
        folder = next(
            (at for at in (source / POLY_MESH, source / "polyMesh", source) if (at / "faces").is_file()), None
        )
        if folder is None:
            raise InputError(f"the folder {source.name} has no constant/polyMesh with a file 'faces'", field="path")
        files = {name: (folder / name).read_bytes() for name in foam.FILES if (folder / name).is_file()}
        return _read(lambda: read_poly_mesh(files), "polyMesh")
    found = format or (VTM[1:] if source.suffix.lower() == VTM else FORMAT_OF.get(source.suffix.lower()))
    if found is None:
        known = ", ".join([*READERS, VTM[1:]])
        message = (
            f"the suffix of {source.name} is of no known format: give one of {known} as the format, or a"
            " folder with constant/polyMesh, a blockMeshDict, or a description as .json"
        )
        raise InputError(message, field="format")
    data = _bytes_of(source)
    if found == VTM[1:]:
        return _read(lambda: read_vtm(data, lambda name: _bytes_of(source.parent / name)), found)
    beside = source.with_suffix(MAP)
    if found == "p3d" and beside.is_file():
        return _read(lambda: read_plot3d(data, beside.read_bytes()), found)
    return read_bytes(data, found)


def read_bytes(data: bytes, format: str) -> PlainMesh:
    """The mesh of the content of a file in a ``format`` of ``READERS``; raises as :func:`read_mesh`."""
    if format not in READERS:
        raise InputError(f"format = {format!r}: choose one of {', '.join(READERS)}", field="format")
    _require_content(data)
    return _read(lambda: READERS[format](data), format)


def _bytes_of(source: Path) -> bytes:
    """The content of a file."""
    try:
        return source.read_bytes()
    except OSError as error:
        raise InputError(f"{source.name} cannot be read: {error.strerror}", field="path") from error


def _read(reader: Callable[[], PlainMesh], name: str) -> PlainMesh:
    """What the reader returns; whatever a broken file raises becomes an error that says so."""
    with refusing(name), np.errstate(invalid="ignore", over="ignore"):
        return reader()


def _packed(data: bytes) -> PlainMesh:
    """The mesh of a zip: the files of a polyMesh in any folder, a Plot3D file with its map, or a vtm with its grids."""
    files: dict[str, bytes] = {}
    grids: dict[str, bytes] = {}
    most = most_unpacked(len(data))
    with open_zip(data, "zip", most, "pack it again by deflate", MAX_MEMBERS) as members:
        for member in members.names:
            name = Path(member)
            is_grid = name.suffix.lower() == VTS
            if not (is_grid or name.name in foam.FILES or name.suffix.lower() in (*PLOT3D, MAP, VTM)):
                continue
            kind = name.suffix.lower() or name.name
            if kind in files and not is_grid:
                raise bad_file(f"the zip has two files {kind!r}: pack one mesh")
            (grids if is_grid else files)[name.name if is_grid else kind] = members.read(member)
    if VTM in files:
        return read_vtm(files[VTM], lambda name: _grid_of(grids, name), most)
    grid = next((files[suffix] for suffix in PLOT3D if suffix in files), None)
    return read_poly_mesh(files) if grid is None else read_plot3d(grid, files.get(MAP))


def _grid_of(grids: dict[str, bytes], file: str) -> bytes:
    """The grid in a zip that has this name, in whatever folder."""
    if Path(file).name not in grids:
        raise bad_file(f"the zip has no file {file[:80]!r}, which its vtm file names: pack it, too")
    return grids[Path(file).name]
