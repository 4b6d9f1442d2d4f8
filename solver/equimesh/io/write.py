"""Mesh files in the formats that solvers read. This is the only module that imports meshio."""

import os
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import meshio
import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.io import foam
from equimesh.io.formats import CELLS, FORMATS, Cells, MeshFormat
from equimesh.io.gmsh import gmsh_text
from equimesh.io.medit import medit_text
from equimesh.io.npz import STEP
from equimesh.io.su2 import su2_text
from equimesh.io.vts import write_vts
from equimesh.io.vtu import write_vtu
from equimesh.io.xdmf import with_time
from equimesh.meshes.mesh import SIDES
from equimesh.meshes.mesh_data import MeshData

__all__ = ["CELLS", "FORMATS", "Cells", "MeshData", "MeshFormat", "write_mesh"]

# Meshes of at most this many points are packed in memory.
MAX_POINTS_IN_MEMORY: Final = 100_000
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same mesh gives the same bytes


def write_mesh(
    path: str | os.PathLike[str], data: MeshData, *, format: str | None = None, cells: Cells = "quad"
) -> tuple[Path, ...]:
    """Write ``data`` to ``path`` and return the files written, the named one first.

    ``format`` is a name in :data:`FORMATS`; without it the suffix of ``path`` decides, and a plain ``.xdmf``
    is then written unpacked, with its three companions ``.h5``, ``_facets.xdmf`` and ``_facets.h5`` next to
    it. A folder that exists is the case of an OpenFOAM solver, and gets the files of ``constant/polyMesh``; other
    files there stay. ``cells="triangle"`` cuts each quadrilateral on its better diagonal; triangles inherit its cell
    data.

    Point data: ``u``, the ``fields`` at nodes, and ``xi``, ``eta``, from which a reader without side tags finds the
    sides (left is ``xi == 0``, right ``xi == 1``, bottom ``eta == 0``, top ``eta == 1``). Cell data: ``Q_eq``,
    ``subdomain`` and the ``cell_fields``.

    Files appear whole or not at all, and the same mesh gives the same bytes. Raises
    :class:`~equimesh.errors.InputError` for an unknown format, suffix or kind of cell and for a folder that
    does not exist, for triangles in a structured grid (``vts``), and ``OSError`` where a file cannot be written.
    """
    path = Path(path)
    unpacked, case = format is None and path.suffix == ".xdmf", format in (None, "foam") and path.is_dir()
    name = "foam" if case else "xdmf" if unpacked else _format_name(path) if format is None else format
    if name not in FORMATS:
        raise InputError(f"unknown mesh format {name!r}: choose one of {', '.join(FORMATS)}", field="format")
    if cells not in CELLS:
        raise InputError(f"unknown kind of cells {cells!r}: choose quad or triangle", field="cells")
    if cells not in FORMATS[name].cells:
        raise InputError(f"a {name} file holds no {cells}s: choose another format, or quad", field="cells")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; make it first", field="path")
    target = path / foam.FOLDER if case else path.parent
    target.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=target, prefix=".equimesh-") as folder:
        if case:
            written = tuple(reversed(_write_foam(Path(folder), data, cells)))
        elif unpacked:
            # the data before the files that refer to it
            written = tuple(reversed(_write_xdmf(Path(folder), data, cells, path.stem, f"{path.stem}_facets")))
        else:
            written = (Path(folder) / path.name,)
            _write_file(written[0], data, name, cells)
        for file in written:
            os.replace(file, target / file.name)
    return tuple(target / file.name for file in reversed(written))


def _format_name(path: Path) -> str:
    for known in FORMATS.values():
        if path.name.endswith(known.suffix):
            return known.name
    suffixes = ", ".join([known.suffix for known in FORMATS.values()] + [".xdmf"])
    raise InputError(f"{path.name!r} has no suffix of a mesh format: choose one of {suffixes}", field="format")


def _write_file(file: Path, data: MeshData, name: str, kind: Cells) -> None:
    match name:
        case "vtu":
            # Compression makes files a third of the size, and takes longer than the solve.
            write_vtu(
                file,
                data.mesh.points,
                _cells(data, kind),
                point_data=_point_data(data),
                cell_data=_cell_data(data, kind),
            )
        case "vtk":
            mesh = _meshio_mesh(data, kind, dimension=3)
            mesh.point_data["node_groups"] = node_groups(data)
            meshio.write(file, mesh, file_format="vtk42")
        case "vts":
            _write_vts(file, data)
        case "xdmf":
            with TemporaryDirectory(dir=file.parent) as folder:
                _pack(file, _write_xdmf(Path(folder), data, kind, "mesh", "facets"))
        case "msh":
            text = gmsh_text(
                data.mesh.points,
                _cells(data, kind),
                data.mesh.sides,
                subdomain=np.repeat(data.subdomain.ravel(), _parts(kind)),
                point_data=_point_data(data),
                cell_data=_cell_data(data, kind),
            )
            file.write_text(text, encoding="ascii", newline="\n")
        case "medit":
            owner = np.repeat(data.subdomain.ravel(), _parts(kind))
            text = medit_text(data.mesh.points, _cells(data, kind), data.mesh.sides, subdomain=owner)
            file.write_text(text, encoding="ascii", newline="\n")
        case "su2":
            text = su2_text(data.mesh.points, _cells(data, kind), data.mesh.sides)
            file.write_text(text, encoding="ascii", newline="\n")
        case "foam":
            with TemporaryDirectory(dir=file.parent) as folder:
                _pack(file, _write_foam(Path(folder), data, kind), f"{foam.FOLDER}/")
        case _:
            arrays: dict[str, Any] = {"x": data.mesh.x, "y": data.mesh.y, **data.mesh.sides}
            if data.u is not None:
                arrays["u"] = data.u
            arrays |= {**data.fields, **data.cell_fields}
            if data.step:
                arrays[STEP] = np.frombuffer(data.step.encode(), np.uint8)
            arrays["cells"] = _cells(data, kind)
            for array, values in (("q_eq", data.q_eq), ("subdomain", data.subdomain)):
                arrays[array] = np.repeat(values.ravel(), _parts(kind))
            if data.mesh.x.size <= MAX_POINTS_IN_MEMORY:  # NumPy writes in small pieces, which takes longer in a file
                buffer = BytesIO()
                np.savez(buffer, **arrays)
                file.write_bytes(buffer.getbuffer())
                return
            with file.open("wb") as stream:
                np.savez(stream, **arrays)


def _write_vts(file: Path, data: MeshData) -> None:
    at_nodes, per_cell = (
        {name: array.reshape(*shape, *array.shape[1:]) for name, array in arrays.items()}
        for arrays, shape in ((_point_data(data), data.mesh.x.shape), (_cell_data(data, "quad"), data.q_eq.shape))
    )
    write_vts(file, data.mesh.x, data.mesh.y, point_data=at_nodes, cell_data=per_cell)


def _write_xdmf(folder: Path, data: MeshData, kind: Cells, mesh: str, facets: str) -> tuple[Path, ...]:
    """The cells, and in separate files the boundary edges with tags 1 to 4: dolfinx reads one after the other."""
    sides = data.mesh.sides
    tags = np.repeat(np.arange(1, 5, dtype=np.int32), [len(sides[side]) for side in SIDES])
    edges = [("line", np.concatenate([sides[side] for side in SIDES]))]
    boundary = meshio.Mesh(data.mesh.points, edges, cell_data={"name_to_read": [tags]})
    meshio.write(folder / f"{mesh}.xdmf", _meshio_mesh(data, kind, dimension=2), file_format="xdmf")
    meshio.write(folder / f"{facets}.xdmf", boundary, file_format="xdmf")
    for stem in (mesh, facets):
        light = folder / f"{stem}.xdmf"
        light.write_text(with_time(light.read_text()), newline="\n")
    return tuple(folder / f"{stem}{suffix}" for stem in (mesh, facets) for suffix in (".xdmf", ".h5"))


def _write_foam(folder: Path, data: MeshData, kind: Cells) -> tuple[Path, ...]:
    """The files of an OpenFOAM mesh."""
    texts = foam.foam_files(data.mesh.points, _cells(data, kind), data.mesh.sides)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="ascii", newline="\n")
    return tuple(folder / name for name in texts)


def _pack(file: Path, parts: tuple[Path, ...], prefix: str = "") -> None:
    """Write a zip of these files, whose names in it begin with ``prefix``."""
    with zipfile.ZipFile(file, "w") as archive:
        for part in parts:
            entry = zipfile.ZipInfo(prefix + part.name, date_time=ZIP_EPOCH)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, part.read_bytes())


def _meshio_mesh(data: MeshData, kind: Cells, *, dimension: int) -> meshio.Mesh:
    points = np.pad(data.mesh.points, ((0, 0), (0, dimension - 2)))
    per_cell: dict[str, list[Any]] = {name: [values] for name, values in _cell_data(data, kind).items()}
    return meshio.Mesh(points, [(kind, _cells(data, kind))], point_data=_point_data(data), cell_data=per_cell)


def _cells(data: MeshData, kind: Cells) -> npt.NDArray[np.int64]:
    return data.triangles() if kind == "triangle" else data.mesh.cells


def _parts(kind: Cells) -> int:
    """How many cells of the file come from one quadrilateral."""
    return 2 if kind == "triangle" else 1


def node_groups(data: MeshData) -> npt.NDArray[np.int32]:
    """SfePy's tag of every node: 0 inside, 1 left, 2 right, 3 bottom, 4 top, and at a corner both digits, as 13."""
    groups = np.zeros(data.mesh.x.size, dtype=np.int32)
    for number, side in enumerate(SIDES, start=1):
        nodes = np.unique(data.mesh.sides[side])
        groups[nodes] = 10 * groups[nodes] + number
    return groups


def _point_data(data: MeshData) -> dict[str, npt.NDArray[np.float64]]:
    xi, eta = data.computational
    u = {} if data.u is None else {"u": data.u.ravel()}
    return {**u, **_flat(data.fields), "xi": xi.ravel(), "eta": eta.ravel()}


def _cell_data(data: MeshData, kind: Cells) -> dict[str, npt.NDArray[Any]]:
    # 32 bits: legacy VTK's "long" has another size on Windows
    values: dict[str, npt.NDArray[Any]] = {"Q_eq": data.q_eq, "subdomain": data.subdomain.astype(np.int32)}
    flat = {name: array.ravel() for name, array in values.items()} | _flat(data.cell_fields)
    return {name: np.repeat(array, _parts(kind), axis=0) for name, array in flat.items()}


def _flat(fields: Mapping[str, npt.NDArray[np.float64]]) -> dict[str, npt.NDArray[np.float64]]:
    """Fields as rows of numbers: a vector in the plane gets a third component, since VTK has no others.

    Vectors of four and more components become one field for each, with its number behind the name.
    """
    flat = {}
    for name, values in fields.items():
        rows = values.reshape(values.shape[0] * values.shape[1], -1)
        if values.ndim == 2:
            flat[name] = rows[:, 0]
        elif rows.shape[1] in (2, 3):
            flat[name] = np.pad(rows, ((0, 0), (0, 3 - rows.shape[1])))
        else:
            flat |= {f"{name}_{k}": np.ascontiguousarray(column) for k, column in enumerate(rows.T)}
    return flat
