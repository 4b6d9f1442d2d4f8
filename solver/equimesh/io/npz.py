"""The arrays of npz files, their bytes, and reading meshes back from them."""

import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.mesh import SIDES, Mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh_coupling.parts import quads_of_triangles

STEP: Final = "step_json"  # the bytes of the JSON of a step: numbers, which every reader of npz files can read
# What the names of the arrays of sides and blocks begin with in the file of a mesh of blocks.
SIDE, BLOCK = "sides/", "blocks/"
TIES: Final = "ties/nodes"
NPZ_ARRAYS: Final = frozenset({"x", "y", "u", "cells", "q_eq", "subdomain", STEP, TIES, *SIDES})  # others are fields

Arrays: TypeAlias = dict[str, Any]


def mesh_arrays(data: MeshData, cells: npt.NDArray[np.int64], every: int) -> Arrays:
    """The arrays of an npz file by their names; ``every`` is the number of its ``cells`` from one quadrilateral.

    A mesh of blocks has flat arrays of nodes, ``sides/<name>`` for the edges of each side, ``blocks/<name>`` for the
    nodes of each block, and ``ties/nodes``. A grid has the last one where its lines are closed. Names of fields have
    no slash.
    """
    mesh = data.mesh
    arrays: Arrays = {"x": mesh.x, "y": mesh.y}
    if not mesh.is_grid:
        arrays |= {f"{SIDE}{name}": edges for name, edges in mesh.sides.items()}
        arrays |= {f"{BLOCK}{name}": nodes for name, nodes in zip(mesh.block_names, mesh.blocks, strict=True)}
    else:
        arrays |= mesh.sides
    if len(mesh.ties) or not mesh.is_grid:
        arrays[TIES] = mesh.ties
    if data.u is not None:
        arrays["u"] = data.u
    arrays |= {**data.fields, **data.cell_fields}
    if data.step:
        arrays[STEP] = np.frombuffer(data.step.encode(), np.uint8)
    arrays["cells"] = cells
    for name, values in (("q_eq", data.q_eq), ("subdomain", data.subdomain)):
        arrays[name] = np.repeat(values.ravel(), every)
    return arrays


def load_npz(source: str | os.PathLike[str] | BinaryIO) -> MeshData:
    """The mesh that :func:`write_mesh` wrote as npz, bit for bit, with its fields at nodes and in cells.

    Triangles are joined to their quadrilaterals again. Raises :class:`~equimesh.errors.InputError` when the
    file is not such an npz.
    """
    try:
        with _opened(source) as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        every = 2 if arrays["cells"].shape[1] == 3 else 1
        mesh = _mesh_of(arrays, every)
        shape = mesh.cell_shape
        q_eq, subdomain = (arrays[name].ravel()[::every].reshape(shape) for name in ("q_eq", "subdomain"))
        step = arrays[STEP].tobytes().decode() if STEP in arrays else ""
    except (KeyError, ValueError, IndexError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        name = Path(source).name if isinstance(source, str | os.PathLike) else "this file"
        raise InputError(f"{name} is not a mesh written by equimesh: {error}", field="path") from error
    others = _fields_of(arrays, mesh)
    in_cells = {name: values for name, values in others.items() if values.shape[: len(shape)] == shape}
    return MeshData(
        mesh=mesh,
        u=arrays.get("u"),
        q_eq=q_eq,
        subdomain=subdomain,
        fields={name: values for name, values in others.items() if name not in in_cells},
        cell_fields=in_cells,
        step=step,
    )


def load_mesh(source: str | os.PathLike[str] | BinaryIO) -> Mesh:
    """The mesh of :func:`load_npz` alone: of a grid nothing but its nodes is read."""
    with _opened(source) as stream:
        with np.load(stream, allow_pickle=False) as archive:
            if {"x", "y", "cells"} <= set(archive.files) and (x := archive["x"]).ndim == 2:
                return Mesh(x, archive["y"], ties=archive[TIES] if TIES in archive.files else None)
        stream.seek(0)
        return load_npz(stream).mesh


def _opened(source: str | os.PathLike[str] | BinaryIO) -> AbstractContextManager[BinaryIO]:
    """A file to be read; one that is open stays so."""
    return open(source, "rb") if isinstance(source, str | os.PathLike) else nullcontext(source)


def _mesh_of(arrays: Arrays, every: int) -> Mesh:
    x, y, cells = arrays["x"], arrays["y"], arrays["cells"]
    if x.ndim != 1:
        return Mesh(x, y, ties=arrays.get(TIES))
    blocks = _named(arrays, BLOCK)
    return Mesh(
        points=np.column_stack([x, y]),
        cells=quads_of_triangles(cells) if every == 2 else cells,
        sides=_named(arrays, SIDE),
        blocks=tuple(blocks.values()),
        block_names=tuple(blocks),
        ties=arrays[TIES],
    )


def _fields_of(arrays: Arrays, mesh: Mesh) -> Arrays:
    """The arrays that are neither of the mesh nor of all meshes."""
    if mesh.is_grid:
        return {name: values for name, values in arrays.items() if name not in NPZ_ARRAYS}
    known = NPZ_ARRAYS - {*SIDES}
    return {name: array for name, array in arrays.items() if name not in known and not name.startswith((SIDE, BLOCK))}


def _named(arrays: Mapping[str, Any], prefix: str) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


# The bytes of a small npz file, made in memory.
#
# The layout is that of a zip file whose members are stored as they are (PKWARE, APPNOTE.TXT 6.3.10, sections 4.3.7,
# 4.3.12 and 4.3.16), each a .npy of version 1.0 in C order. numpy.savez writes the members through a zip file object,
# which takes longer than copying the arrays of a small mesh.

LOCAL: Final = struct.Struct("<4s5H3L2H")
CENTRAL: Final = struct.Struct("<4s6H3L5H2L")
END: Final = struct.Struct("<4s4H2LH")
VERSION: Final = 20  # of the format, which has no members of 4 GiB
UTF_8: Final = 0x800  # the names are UTF-8
MIDNIGHT, FIRST_DAY = 0, 1 << 5 | 1  # 1 January 1980, the first day that a zip file knows
MAX_BYTES: Final = 4_000_000_000  # of the arrays; places are numbers of 32 bits
MAX_ARRAYS: Final = 1 << 15


def npz_bytes(arrays: Mapping[str, Any]) -> bytes:
    """The npz file of ``arrays``, which :func:`numpy.load` reads; equal arrays have equal bytes.

    Raises :class:`ValueError` for arrays of Python objects.
    """
    found = {name: np.asarray(values, order="C") for name, values in arrays.items()}
    if _is_large(found):
        stream = BytesIO()
        np.savez(stream, **arrays)  # in the 64 bit form of a zip file
        return stream.getvalue()
    return b"".join(_pieces(found, _PLAIN))


def save_npz(file: IO[bytes], arrays: Mapping[str, Any]) -> None:
    """Write the bytes that :func:`numpy.savez` of NumPy 2 writes on Unix, so that their hashes are those of before.

    Raises :class:`ValueError` for arrays of Python objects.
    """
    if _is_large(arrays):
        np.savez(file, **arrays)
    else:
        file.writelines(_pieces(arrays, _NUMPY))


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """What differs between plain zip files: version, flags, where they were made, and the sizes of 64 bits if any."""

    version: int
    flags: int
    made: int
    mode: int
    sizes: struct.Struct | None = None

    def head(self, name: bytes, check: int, size: int) -> tuple[int, ...]:
        """The fields that the head of a member and its entry in the list share, up to the length of its name."""
        return self.version, self.flags, 0, MIDNIGHT, FIRST_DAY, check, size, size, len(name)

    def local(self, name: bytes, check: int, size: int) -> bytes:
        """The head of a member."""
        if self.sizes is None:
            return LOCAL.pack(b"PK\x03\x04", *self.head(name, check, size), 0) + name
        fields = *self.head(name, check, 0xFFFFFFFF), self.sizes.size
        return LOCAL.pack(b"PK\x03\x04", *fields) + name + self.sizes.pack(1, 16, size, size)


_PLAIN: Final = _Layout(version=VERSION, flags=UTF_8, made=VERSION, mode=0)
_NUMPY: Final = _Layout(version=45, flags=0, made=3 << 8 | 45, mode=0o600 << 16, sizes=struct.Struct("<2H2Q"))


def _is_large(arrays: Mapping[str, npt.NDArray[Any]]) -> bool:
    return sum(array.nbytes for array in arrays.values()) > MAX_BYTES or len(arrays) > MAX_ARRAYS


def _pieces(arrays: Mapping[str, npt.NDArray[Any]], layout: _Layout) -> list[bytes | memoryview]:
    out, entries, place = list[bytes | memoryview](), list[bytes](), 0
    for key, array in arrays.items():
        is_turned = array.flags.f_contiguous and not array.flags.c_contiguous
        name, head, data = f"{key}.npy".encode(), _head(array.dtype, array.shape, is_turned), _data(array)
        check, size = zlib.crc32(data, zlib.crc32(head)), len(head) + array.nbytes
        local = layout.local(name, check, size)
        out += (local, head, data)
        fields = *layout.head(name, check, size), 0, 0, 0, 0, layout.mode, place
        entries += (CENTRAL.pack(b"PK\x01\x02", layout.made, *fields), name)
        place += len(local) + size
    listed, count = b"".join(entries), len(arrays)
    return [*out, listed, END.pack(b"PK\x05\x06", 0, 0, count, count, len(listed), place, 0)]


def _data(array: npt.NDArray[Any]) -> memoryview:
    """The bytes of an array as they lie there, without a copy; else in C order."""
    return array.ravel("A").view(np.uint8).data if array.size else memoryview(b"")


@lru_cache(maxsize=1024)
def _head(dtype: np.dtype[Any], shape: tuple[int, ...], is_turned: bool) -> bytes:
    """What comes before the data of a ``.npy``, by NumPy itself."""
    if dtype.hasobject:
        raise ValueError(f"an npz file without pickles cannot hold {dtype}")
    head = BytesIO()
    description = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": is_turned, "shape": shape}
    np.lib.format.write_array_header_1_0(head, description)
    return head.getvalue()
