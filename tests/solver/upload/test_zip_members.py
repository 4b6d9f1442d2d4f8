"""Files that would take far more memory or time than their bytes: refused, and at once."""

from __future__ import annotations

import io
import re
import struct
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.upload.samples import read_arrays

ZEROS = bytes(20_000_000)
MOST = 8_000_000


def npy(header: str, version: int = 1) -> bytes:
    """An npy file that holds a header, and nothing else."""
    length = len(header).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode()


def shaped(shape: str) -> bytes:
    """An npy file that claims a shape."""
    return npy(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n")


def objects() -> bytes:
    """An npy file of Python objects, which would be unpickled."""
    stream = io.BytesIO()
    np.save(stream, np.array([{}], dtype=object), allow_pickle=True)
    return stream.getvalue()


def npz(content: bytes, method: int = zipfile.ZIP_DEFLATED, *, claimed: int | None = None, more: int = 0) -> bytes:
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
    "one that says so": ("u.npz", npz(ZEROS), "unpacks to more than"),
    "one that says it is small": ("u.npz", npz(ZEROS, claimed=1000), "cannot be unpacked"),
    "one of another packing": ("u.npz", npz(ZEROS, zipfile.ZIP_BZIP2, claimed=1000), "use deflate"),
    "one of another packing still": ("u.npz", npz(ZEROS, zipfile.ZIP_LZMA, claimed=1000), "use deflate"),
    "one inside another": ("u.npz", npz(npz(ZEROS)), "not a plain npy array"),
    "very many members": ("u.npz", npz(b"", more=20_000), "more than 1000 members"),
    "objects": ("u.npz", npz(objects()), "only real numbers"),
    "objects alone": ("u.npy", objects(), "only real numbers"),
    "a huge shape": ("u.npy", shaped("(1000000000, 1000000000)"), "has 0 bytes"),
    "a shape of many digits": ("u.npy", shaped(f"({'9' * 90},)"), "has 0 bytes"),
    "a huge shape of no number": ("u.npy", shaped(f"(0, {'9' * 60})"), "has 0 bytes"),
    "many dimensions": ("u.npy", shaped(f"({'0,' * 45})"), "has 0 bytes"),
    "a huge header": ("u.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + b"x" * 100, "not a plain npy array"),
    "deep XML": ("u.vtu", b"<VTKFile>" + b"<a>" * 1_000_000 + b"</a>" * 1_000_000 + b"</VTKFile>", "more than 100000"),
    "XML not quite as deep": (
        "u.vtu",
        b"<VTKFile>" + b"<a>" * 40_000 + b"</a>" * 40_000 + b"</VTKFile>",
        "levels deep",
    ),
    "wide XML": ("u.vtu", b"<VTKFile>" + b"<a/>" * 1_000_000 + b"</VTKFile>", "more than 100000 elements"),
    "many attributes": ("u.vtu", b"<VTKFile " + b"".join(b"a%d='' " % k for k in range(500_000)) + b"/>", "attributes"),
    "entities": ("u.vtu", b'<!DOCTYPE a [<!ENTITY b "c">]><VTKFile>&b;</VTKFile>', "declares entities"),
    "a count of points": (
        "u.vtk",
        b"# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\nPOINTS 999999999 double\n",
        "ends",
    ),
    "deep JSON": ("u.json", b"[" * 4_000_000, "cannot be read"),
    "a long number": ("u.json", b'{"values":[' + b"9" * 4_000_000 + b"]}", "cannot be read"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused(name: str) -> None:
    filename, data, match = BOMBS[name]
    assert len(data) <= MOST
    _peak()  # from here on
    before, began = _peak(), time.process_time()
    with pytest.raises(SamplesError, match=match):
        read_arrays(data, filename, max_bytes=MOST)
    assert time.process_time() - began < 1.0
    assert _peak() - before < 15_000_000


def _peak() -> int:
    """Most bytes that this process held since it was last asked; 0 where the system does not tell."""
    if sys.platform != "linux":
        return 0
    found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    Path("/proc/self/clear_refs").write_text("5")
    assert found is not None
    return int(found[1]) * 1024
