"""Members of zip files: damaged ones, and files that would take far more memory or time than their bytes."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest

from solver.upload.bombs import check_bomb_is_refused
from solver.upload.files import TABLE, X, Y, npy, npz, refused


def test_npz_that_is_none() -> None:
    refused(b"PK nonsense", "u.npz", "cannot be unpacked", "numpy.savez")
    refused(npz(x=X, y=Y, values=TABLE)[:-40], "u.npz", "cannot be unpacked")
    refused(npy(TABLE), "u.npz", "cannot be unpacked")


def test_npz_with_damaged_contents() -> None:
    data = bytearray(npz(x=X, y=Y, values=TABLE))
    at = data.index(b"values.npy") + 60
    data[at] ^= 0xFF
    refused(bytes(data), "u.npz")


def test_a_zip_bomb_is_not_unpacked() -> None:
    bomb = npz(x=X, y=Y, values=np.zeros(4_000_000))
    assert len(bomb) < 100_000
    refused(bomb, "u.npz", "unpacks to more than", max_bytes=1_000_000)


def test_every_member_of_a_zip_is_bounded_together() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("x", "y", "values"):
            archive.writestr(f"{name}.npy", npy(np.zeros(50_000)))
    refused(stream.getvalue(), "u.npz", "unpacks to more than", max_bytes=900_000)


ZEROS = bytes(20_000_000)


def npy_header(header: str, version: int = 1) -> bytes:
    """An npy file that holds a header, and nothing else."""
    length = len(header).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode()


def shaped(shape: str) -> bytes:
    """An npy file that claims a shape."""
    return npy_header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n")


def objects() -> bytes:
    """An npy file of Python objects, which would be unpickled."""
    stream = io.BytesIO()
    np.save(stream, np.array([{}], dtype=object), allow_pickle=True)
    return stream.getvalue()


def zipped_as_npz(
    content: bytes, method: int = zipfile.ZIP_DEFLATED, *, claimed: int | None = None, more: int = 0
) -> bytes:
    """A zip file like an npz; ``claimed`` is what it says of the size of the first member."""
    stream, axis = io.BytesIO(), io.BytesIO()
    np.save(axis, np.linspace(0.0, 1.0, 3))
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("values.npy", content, compress_type=method)
        for name in ("x.npy", "y.npy", *(f"m{k}.npy" for k in range(more))):
            archive.writestr(name, axis.getvalue())
    data = stream.getvalue()
    return data if claimed is None else data.replace(struct.pack("<I", len(content)), struct.pack("<I", claimed))


BOMBS = {
    "one that says so": ("u.npz", lambda: zipped_as_npz(ZEROS), "unpacks to more than"),
    "one that says it is small": ("u.npz", lambda: zipped_as_npz(ZEROS, claimed=1000), "cannot be unpacked"),
    "one of another packing": ("u.npz", lambda: zipped_as_npz(ZEROS, zipfile.ZIP_BZIP2, claimed=1000), "use deflate"),
    "one of another packing still": (
        "u.npz",
        lambda: zipped_as_npz(ZEROS, zipfile.ZIP_LZMA, claimed=1000),
        "use deflate",
    ),
    "one inside another": ("u.npz", lambda: zipped_as_npz(zipped_as_npz(ZEROS)), "not a plain npy array"),
    "very many members": ("u.npz", lambda: zipped_as_npz(b"", more=20_000), "more than 1000 members"),
    "objects": ("u.npz", lambda: zipped_as_npz(objects()), "only real numbers"),
    "objects alone": ("u.npy", lambda: objects(), "only real numbers"),
    "a huge shape": ("u.npy", lambda: shaped("(1000000000, 1000000000)"), "has 0 bytes"),
    "a shape of many digits": ("u.npy", lambda: shaped(f"({'9' * 90},)"), "has 0 bytes"),
    "a huge shape of no number": ("u.npy", lambda: shaped(f"(0, {'9' * 60})"), "has 0 bytes"),
    "many dimensions": ("u.npy", lambda: shaped(f"({'0,' * 45})"), "has 0 bytes"),
    "a huge header": ("u.npy", lambda: b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + b"x" * 100, "not a plain npy array"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused(name: str) -> None:
    filename, pack, match = BOMBS[name]
    check_bomb_is_refused(pack(), filename, match)
