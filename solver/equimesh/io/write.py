"""Writing a mesh with its data in every format."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.io import solver_files
from equimesh.io.abaqus import abaqus_text
from equimesh.io.formats import CELLS, FORMATS, Cells, MeshFormat
from equimesh.io.npz import mesh_arrays, npz_bytes
from equimesh.io.solver_files import gmsh_text, medit_text, neutral_map, plot3d_text, su2_text, with_time
from equimesh.io.spectral import hohqmesh_text, nmsh_bytes, re2_bytes, specfem_files
from equimesh.io.vtk import vtm_text, write_hdf, write_vts, write_vtu
from equimesh.meshes.cell_edges import Join
from equimesh.meshes.interfaces import contacts
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_data import MeshData, at_one_place
from equimesh.meshes.second_order import SecondOrderMesh
from equimesh.numerics.types import IntArray

if TYPE_CHECKING:
    import meshio

# The data of a mesh as files take them: flat arrays by name, in the order of nodes and cells.

# What the names of the edges of a side begin with in the field data of a vtu file of blocks.
SIDE_DATA: Final = "sides/"


def corners_of(data: MeshData, kind: Cells) -> npt.NDArray[np.int64]:
    """The nodes of the cells of this ``kind``."""
    return data.triangles() if kind == "triangle" else data.mesh.cells


@dataclass(frozen=True, kw_only=True, eq=False)
class FileCells:
    """The nodes, cells and edges of sides as a file of cells of order 1 or 2 has them."""

    points: npt.NDArray[np.float64]
    cells: IntArray
    sides: Mapping[str, IntArray]
    joins: tuple[Join, ...]
    second: SecondOrderMesh | None = None

    @classmethod
    def of(cls, data: MeshData, kind: Cells, order: int) -> FileCells:
        """From the data of a mesh; raises as :class:`~equimesh.meshes.second_order.SecondOrderMesh`."""
        mesh, corners = data.mesh, corners_of(data, kind)
        if order == 1:
            return cls(points=mesh.points, cells=corners, sides=mesh.sides, joins=_joins(data))
        second = SecondOrderMesh.of(mesh.points, mesh.cells, data.curved)
        joins = [
            replace(join, edges=second.edges(join.edges), original_edges=second.edges(join.original_edges))
            for join in _joins(data)
        ]
        return cls(
            points=second.points,
            cells=second.triangles(corners) if kind == "triangle" else second.cells,
            sides={name: second.edges(edges) for name, edges in mesh.sides.items()},
            joins=tuple(joins),
            second=second,
        )

    def at_nodes(self, values: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
        """Values at the nodes of the mesh as values at those of the file: between corners their means."""
        return {name: one if self.second is None else self.second.at_nodes(one) for name, one in values.items()}

    @property
    def without_centres(self) -> FileCells:
        """The same cells without the nodes in the middle of quadrilaterals, for formats that have none."""
        if self.second is None or self.cells.shape[1] != 9:
            return self
        return replace(self, points=self.points[: self.second.without_centres], cells=self.cells[:, :8])


def per_quad(kind: Cells) -> int:
    """How many cells of the file come from one quadrilateral."""
    return 2 if kind == "triangle" else 1


def node_groups(data: MeshData, of: FileCells | None = None) -> npt.NDArray[np.int32]:
    """SfePy's tag of every node: 0 inside, the number of its side, from 1, and at a corner both numbers, as 13.

    The nodes are those of the mesh, or those ``of`` a file. A grid has 1 left, 2 right, 3 bottom, 4 top. With ten sides
    or more each number has as many digits as the last one.
    """
    sides = data.mesh.sides if of is None else of.sides
    groups = np.zeros(data.mesh.x.size if of is None else len(of.points), dtype=np.int32)
    shift = 10 ** len(str(len(sides)))
    for number, edges in enumerate(sides.values(), start=1):
        nodes = np.unique(edges)
        groups[nodes] = shift * groups[nodes] + number
    return groups


def side_data(data: MeshData, sides: Mapping[str, IntArray]) -> dict[str, IntArray]:
    """The edges of the sides of blocks; a grid has ``xi`` and ``eta`` to find its own."""
    if data.mesh.is_grid:
        return {}
    return {f"{SIDE_DATA}{name}": edges.astype(np.int64) for name, edges in sides.items()}


def point_data(data: MeshData) -> dict[str, npt.NDArray[np.float64]]:
    """The data at the nodes by name: u, the fields, and ``xi`` and ``eta`` of a grid."""
    u = {} if data.u is None else {"u": data.u.ravel()}
    found = {**u, **_flat(data.fields, len(data.mesh.node_shape))}
    if not data.mesh.is_grid:
        return found
    xi, eta = data.computational
    return {**found, "xi": xi.ravel(), "eta": eta.ravel()}


def cell_data(data: MeshData, kind: Cells) -> dict[str, npt.NDArray[Any]]:
    """The data in the cells of this ``kind`` by name: ``Q_eq``, ``subdomain`` and the cell fields."""
    # 32 bits: legacy VTK's "long" has another size on Windows
    values: dict[str, npt.NDArray[Any]] = {"Q_eq": data.q_eq, "subdomain": data.subdomain.astype(np.int32)}
    flat = {name: array.ravel() for name, array in values.items()}
    flat |= _flat(data.cell_fields, len(data.mesh.cell_shape))
    return {name: np.repeat(array, per_quad(kind), axis=0) for name, array in flat.items()}


def _flat(fields: Mapping[str, npt.NDArray[np.float64]], axes: int) -> dict[str, npt.NDArray[np.float64]]:
    """Fields as rows of numbers, where the first ``axes`` are those of nodes or cells.

    A vector in the plane gets a third component, since VTK has no others. Vectors of four and more components become
    one field for each, with its number behind the name.
    """
    flat = {}
    for name, values in fields.items():
        rows = values.reshape(math.prod(values.shape[:axes]), -1)
        if values.ndim == axes:
            flat[name] = rows[:, 0]
        elif rows.shape[1] in (2, 3):
            flat[name] = np.pad(rows, ((0, 0), (0, 3 - rows.shape[1])))
        else:
            flat |= {f"{name}_{k}": np.ascontiguousarray(column) for k, column in enumerate(rows.T)}
    return flat


__all__ = ["CELLS", "FORMATS", "Cells", "MeshData", "MeshFormat", "write_mesh"]

# Meshes of at most this many points are packed in memory.
MAX_POINTS_IN_MEMORY: Final = 100_000
# Suffixes whose files are written next to each other instead of into a zip.
UNPACKED: Final = {".xdmf": "xdmf", ".vtm": "vtm", ".xyz": "p3d", ".p3d": "p3d"}
# Formats with arrays of (n_xi, n_eta) nodes, which keep both copies of the seam of closed lines.
KEPT: Final = {"npz", "vts", "vtm", "p3d"}
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same mesh gives the same bytes


def write_mesh(
    path: str | os.PathLike[str],
    data: MeshData,
    *,
    format: str | None = None,
    cells: Cells = "quad",
    order: Literal[1, 2] = 1,
) -> tuple[Path, ...]:
    """Write ``data`` to ``path`` and return the files written, the named one first.

    ``format`` is a name in :data:`FORMATS`; without it the suffix of ``path`` decides, and a plain ``.xdmf``
    is then written unpacked, with its three companions ``.h5``, ``_facets.xdmf`` and ``_facets.h5`` next to
    it. So are a plain ``.vtm`` with a ``.vts`` for each block, and a plain ``.xyz`` or ``.p3d`` with its ``.nmf``. A
    folder that exists is the case of an OpenFOAM solver, and gets the files of ``constant/polyMesh``; other files
    there stay. ``cells="triangle"`` cuts each quadrilateral on its better diagonal; triangles inherit its cell
    data.

    With ``order=2`` cells have a node in the middle of each edge, and quadrilaterals one in their centre, but for
    ``abaqus``. On curved sides these lie on the curve, if ``data.curved`` has it; inside edges are straight, unless a
    cell would fold. Data there are the means of the corners.

    Point data: ``u``, the ``fields`` at nodes, and ``xi``, ``eta``, from which a reader without side tags finds the
    sides (left is ``xi == 0``, right ``xi == 1``, bottom ``eta == 0``, top ``eta == 1``). A mesh of blocks has neither.
    Cell data: ``Q_eq``, ``subdomain`` and the ``cell_fields``.

    Where grid lines are closed, formats with rows and columns (``npz``, ``vts``, ``vtm``, ``p3d``) keep both copies of
    a seam. In the others every node of a ring has one number, and its seam is no side. A periodic rectangle keeps its
    sides, which ``foam`` names as a pair of cyclic patches and ``msh`` as periodic curves.

    Files appear whole or not at all, and the same mesh gives the same bytes. Raises
    :class:`~equimesh.errors.InputError` for what is no data, for an unknown format, suffix or kind of cell, for a
    folder that does not exist, for an order that the format does not have, for triangles in structured grids (``vts``,
    ``vtm``, ``p3d``), for blocks in one such grid (``vts``), and ``OSError`` where a file cannot be written.
    """
    if not isinstance(data, MeshData):
        raise InputError(f"data = {data!r:.60}: give the data of a solution, solution.data()", field="data")
    path = Path(path)
    unpacked, case = format is None and path.suffix in UNPACKED, format in (None, "foam") and path.is_dir()
    if format is None:
        format = "foam" if case else UNPACKED[path.suffix] if unpacked else _format_name(path)
    name = format
    if name not in FORMATS:
        raise InputError(f"unknown mesh format {name!r}: choose one of {', '.join(FORMATS)}", field="format")
    if cells not in CELLS:
        raise InputError(f"unknown kind of cells {cells!r}: choose quad or triangle", field="cells")
    if cells not in FORMATS[name].cells:
        raise InputError(f"a {name} file holds no {cells}s: choose another format, or quad", field="cells")
    _check_order(name, order)
    if FORMATS[name].grids_only and not data.mesh.is_grid:
        raise InputError(f"a {name} file holds one grid, not blocks: choose vtm or vtu", field="format")
    if name not in KEPT:
        data = _merged(data)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; make it first", field="path")
    target = path / solver_files.FOLDER if case else path.parent
    target.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=target, prefix=".equimesh-") as folder:
        if case:
            written = tuple(reversed(_write_foam(Path(folder), data, cells)))
        elif unpacked:
            # the data before the files that refer to it
            written = tuple(reversed(_write_several(Path(folder), data, name, cells, path)))
        else:
            written = (Path(folder) / path.name,)
            _write_file(written[0], data, name, cells, order)
        for file in written:
            os.replace(file, target / file.name)
    return tuple(target / file.name for file in reversed(written))


def _check_order(name: str, order: object) -> None:
    """Refuse an order of cells that there is not, or that a format does not have."""
    if order not in (1, 2) or isinstance(order, bool):
        raise InputError(f"order = {str(order)[:20]}: cells have order 1, or 2 with curved edges", field="order")
    if order == 2 and not FORMATS[name].second_order:
        known = ", ".join(form.name for form in FORMATS.values() if form.second_order)
        raise InputError(f"a {name} file holds cells of order 1: choose one of {known}, or order 1", field="order")


def mesh_bytes(data: MeshData, *, format: str, cells: Cells = "quad") -> bytes:
    """The bytes of the file that :func:`write_mesh` writes; an npz file is made in memory.

    Raises as :func:`write_mesh`.
    """
    if format == "npz":
        return npz_bytes(mesh_arrays(data, corners_of(data, cells), per_quad(cells)))
    with TemporaryDirectory(prefix=".equimesh-") as folder:
        return write_mesh(Path(folder) / "mesh", data, format=format, cells=cells)[0].read_bytes()


def _format_name(path: Path) -> str:
    for known in FORMATS.values():
        if path.name.endswith(known.suffix):
            return known.name
    suffixes = ", ".join([*(known.suffix for known in FORMATS.values()), *UNPACKED])
    raise InputError(f"{path.name!r} has no suffix of a mesh format: choose one of {suffixes}", field="format")


def _write_file(file: Path, data: MeshData, name: str, kind: Cells, order: int = 1) -> None:
    match name:
        case "vtu":
            of = FileCells.of(data, kind, order)
            # Compression makes files a third of the size, and takes longer than the solve.
            write_vtu(
                file,
                of.points,
                of.cells,
                point_data=of.at_nodes(point_data(data)),
                cell_data=cell_data(data, kind),
                field_data=side_data(data, of.sides),
            )
        case "hdf":
            of = FileCells.of(data, kind, order)
            at_nodes = {**of.at_nodes(point_data(data)), "node_groups": node_groups(data, of)}
            write_hdf(file, of.points, of.cells, point_data=at_nodes, cell_data=cell_data(data, kind))
        case "vtk":
            import meshio

            mesh = _meshio_mesh(data, kind, dimension=3)
            mesh.point_data["node_groups"] = node_groups(data)
            meshio.write(file, mesh, file_format="vtk42")
        case "vts":
            _write_vts(file, data)
        case "xdmf" | "vtm" | "p3d":
            with TemporaryDirectory(dir=file.parent) as folder:
                first = Path(folder) / {"xdmf": "mesh.xdmf", "vtm": "mesh.vtm", "p3d": "mesh.xyz"}[name]
                _pack(file, _write_several(Path(folder), data, name, kind, first))
        case "msh":
            of = FileCells.of(data, kind, order)
            text = gmsh_text(
                of.points,
                of.cells,
                of.sides,
                subdomain=np.repeat(data.subdomain.ravel(), per_quad(kind)),
                point_data=of.at_nodes(point_data(data)),
                cell_data=cell_data(data, kind),
                joins=of.joins,
            )
            file.write_text(text, encoding="utf-8", newline="\n")
        case "medit":
            owner = np.repeat(data.subdomain.ravel(), per_quad(kind))
            text = medit_text(data.mesh.points, corners_of(data, kind), data.mesh.sides, subdomain=owner)
            file.write_text(text, encoding="ascii", newline="\n")
        case "su2":
            text = su2_text(data.mesh.points, corners_of(data, kind), data.mesh.sides)
            file.write_text(text, encoding="ascii", newline="\n")
        case "abaqus":
            owner = np.repeat(data.subdomain.ravel(), per_quad(kind))
            of = FileCells.of(data, kind, order).without_centres
            text = abaqus_text(of.points, of.cells, of.sides, subdomain=owner)
            file.write_text(text, encoding="ascii", newline="\n")
        case "hohqmesh":
            of = FileCells.of(data, kind, order)
            file.write_text(hohqmesh_text(of.points, of.cells, of.sides), encoding="utf-8", newline="\n")
        case "re2" | "nmsh":
            of, make = FileCells.of(data, kind, order), {"re2": re2_bytes, "nmsh": nmsh_bytes}[name]
            file.write_bytes(make(of.points, of.cells, of.sides))
        case "specfem":
            of = FileCells.of(data, kind, order)
            texts = specfem_files(of.points, of.cells, of.sides, subdomain=data.subdomain)
            with TemporaryDirectory(dir=file.parent) as folder:
                _pack(file, _written(Path(folder), texts))
        case "foam":
            with TemporaryDirectory(dir=file.parent) as folder:
                _pack(file, _write_foam(Path(folder), data, kind), f"{solver_files.FOLDER}/")
        case _:
            arrays = mesh_arrays(data, corners_of(data, kind), per_quad(kind))
            if data.mesh.x.size <= MAX_POINTS_IN_MEMORY:
                file.write_bytes(npz_bytes(arrays))
                return
            with file.open("wb") as stream:
                np.savez(stream, **arrays)


def _write_several(folder: Path, data: MeshData, name: str, kind: Cells, path: Path) -> tuple[Path, ...]:
    """The files of one mesh in this folder: that with the name of ``path`` first, the others with names like it."""
    if name == "xdmf":
        facets = "facets" if path.parent == folder else f"{path.stem}_facets"
        return _write_xdmf(folder, data, kind, path.stem, facets)
    return _write_vtm(folder, data, path.stem) if name == "vtm" else _write_plot3d(folder, data, path)


def _write_vts(file: Path, data: MeshData) -> None:
    mesh = data.grid_mesh
    at_nodes, per_cell = (
        {name: array.reshape(*shape, *array.shape[1:]) for name, array in arrays.items()}
        for arrays, shape in ((point_data(data), mesh.node_shape), (cell_data(data, "quad"), mesh.cell_shape))
    )
    write_vts(file, mesh.x, mesh.y, point_data=at_nodes, cell_data=per_cell)


def _write_vtm(folder: Path, data: MeshData, stem: str) -> tuple[Path, ...]:
    """The head, and a structured grid for each block."""
    mesh = _blocks_of(data)
    at_nodes, per_cell = point_data(data), cell_data(data, "quad")
    head, files = folder / f"{stem}.vtm", list[Path]()
    for number, (nodes, cells) in enumerate(zip(mesh.blocks, mesh.block_cells, strict=True)):
        files.append(folder / f"{stem}_{number}.vts")
        block = mesh.block_mesh(number)
        write_vts(
            files[-1],
            block.x,
            block.y,
            point_data={name: values[nodes] for name, values in at_nodes.items()},
            cell_data={name: values[cells] for name, values in per_cell.items()},
        )
    named = [(name, file.name) for name, file in zip(mesh.block_names, files, strict=True)]
    head.write_text(vtm_text(named), encoding="utf-8", newline="\n")
    return head, *files


def _write_plot3d(folder: Path, data: MeshData, path: Path) -> tuple[Path, ...]:
    """The grid, and the neutral map file."""
    mesh = _blocks_of(data)
    grid, neutral = folder / path.name, folder / f"{path.stem}.nmf"
    text = plot3d_text([(block.x, block.y) for block in map(mesh.block_mesh, range(len(mesh.blocks)))])
    grid.write_text(text, encoding="ascii", newline="\n")
    shapes = [(block.shape[0], block.shape[1]) for block in mesh.blocks]
    neutral.write_text(neutral_map(shapes, contacts(mesh)), encoding="ascii", newline="\n")
    return grid, neutral


def _blocks_of(data: MeshData) -> Mesh:
    """The mesh; raises :class:`~equimesh.errors.InputError` where its blocks are not known."""
    if not data.mesh.blocks:
        message = "the blocks of this mesh are not known: choose a format without blocks, such as vtu or msh"
        raise InputError(message, field="format")
    return data.mesh


def _write_xdmf(folder: Path, data: MeshData, kind: Cells, mesh: str, facets: str) -> tuple[Path, ...]:
    """The cells, and in separate files the boundary edges with tags from 1: dolfinx reads one after the other."""
    import meshio

    sides = data.mesh.sides
    tags = np.repeat(np.arange(1, len(sides) + 1, dtype=np.int32), [len(edges) for edges in sides.values()])
    edges = [("line", np.concatenate([np.empty((0, 2), np.int64), *sides.values()]))]
    boundary = meshio.Mesh(data.mesh.points, edges, cell_data={"name_to_read": [tags]})
    meshio.write(folder / f"{mesh}.xdmf", _meshio_mesh(data, kind, dimension=2), file_format="xdmf")
    meshio.write(folder / f"{facets}.xdmf", boundary, file_format="xdmf")
    for stem in (mesh, facets):
        light = folder / f"{stem}.xdmf"
        light.write_text(with_time(light.read_text()), newline="\n")
    return tuple(folder / f"{stem}{suffix}" for stem in (mesh, facets) for suffix in (".xdmf", ".h5"))


def _write_foam(folder: Path, data: MeshData, kind: Cells) -> tuple[Path, ...]:
    """The files of an OpenFOAM mesh."""
    return _written(
        folder, solver_files.foam_files(data.mesh.points, corners_of(data, kind), data.mesh.sides, _joins(data))
    )


def _written(folder: Path, texts: Mapping[str, str]) -> tuple[Path, ...]:
    """The files with these texts, by their names."""
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
    import meshio

    points = np.pad(data.mesh.points, ((0, 0), (0, dimension - 2)))
    per_cell: dict[str, list[Any]] = {name: [values] for name, values in cell_data(data, kind).items()}
    return meshio.Mesh(points, [(kind, corners_of(data, kind))], point_data=point_data(data), cell_data=per_cell)


def _joins(data: MeshData) -> tuple[Join, ...]:
    """The joined sides of a mesh of blocks, or of a grid whose lines are closed by a translation."""
    return data.mesh.periodic


def _merged(data: MeshData) -> MeshData:
    """The data without second copies of nodes at one place: to solvers these would be a slit."""
    if not (data.mesh.is_grid and at_one_place(data.mesh.points, data.mesh.ties).any()):
        return data
    return data.joined
