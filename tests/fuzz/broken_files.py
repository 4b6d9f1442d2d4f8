"""Files of samples and of meshes broken at random, read in a program of its own with little memory.

``python -m fuzz.broken_files FOLDER CASES SEED`` ends with 0 when every case of every format was read, or refused with
a sentence. A reader that reserves what a header promises, opens another file, unpickles, warns, or takes seconds ends
it with the reason.
"""

from __future__ import annotations

import io
import json
import os
import resource
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import meshio
import numpy as np
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from equimesh.errors import InputError
from equimesh.upload.columns import Limits
from equimesh.upload.samples import READERS
from equimesh_service.assembly.samples import convert, convert_mesh
from fuzz.good_meshes import MESH_PARTS, good_meshes
from solver.upload.files import CLOUD, CLOUD_U, TABLE, X, Y, csv, npy, npz
from solver.upload.markup import VTK_HEAD, vtu

MEMORY = 256 * 2**20  # on top of what the readers need to start
LIMITS = Limits(max_bytes=1_000_000)
# Some milliseconds are usual; a file that takes a reader this long would delay the service.
MOST_SECONDS = 30.0
FORBIDDEN = ("pickle.find_class", "socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system")
BYTES = st.sampled_from([b"\x00", b"\x01", b"\x7f", b"\x80", b"\xff", b"9", b"-", b" ", b"\n", b"e", b"(", b"<"])
MIN_POINTS_FOR_THREADS = st.sampled_from(
    [b"\xff" * 4, b"\xff" * 8, b"\x00" * 8, b"\x00\x00\x00\x40", b"9" * 20, b"1e999", b"nan"]
)
PARTS = {
    "npz": [b"PK\x01\x02", b"PK\x05\x06", b"values.npy", b"../x.npy", b"\x93NUMPY"],
    "npy": [b"\x93NUMPY", b"'descr': '|O'", b"(1 2,)", b"(10**9,)", b"'shape': ()", b"cos\nsystem\n(S'true'\ntR."],
    "txt": [b"x y T p\n", b"matrix", b" ", b"\t", b"1 2 3 4\n"],
    "csv": [b"x,y,u\n", b"#", b'"', b"\xef\xbb\xbf", b";", b"1_0", b"inf"],
    "json": [b"NaN", b"null", b"[[", b"{}", b'{"grid":', b"true", b'"a"', b"1e400"],
    "vtu": [b"<!DOCTYPE a>", b"&amp;", b"&x;", b"<Piece>", b"NumberOfPoints='-1'", b"format='appended' offset='-9'"],
    "vtk": [
        b"POINTS 99999999999 double\n",
        b"FIELD f 99999999\n",
        b"METADATA\n",
        b"CELLS 1 1\n",
        b"LOOKUP_TABLE t -1\n",
    ],
}


def written_by_meshio(folder: Path, form: str, **options: Any) -> bytes:
    path = folder / "u.mesh"
    mesh = meshio.Mesh(np.pad(CLOUD, ((0, 0), (0, 1))), [("vertex", [[0], [1]])], point_data={"u": CLOUD_U})
    meshio.write(path, mesh, file_format=form, **options)
    return path.read_bytes()


def good_files(folder: Path) -> dict[str, list[bytes]]:
    """Files of every format that are read."""
    grid = {"grid": {"x": X.tolist(), "y": Y.tolist(), "values": TABLE.tolist()}}
    places, u = (" ".join(map(repr, a.ravel().tolist())) for a in (np.pad(CLOUD, ((0, 0), (0, 1))), CLOUD_U))
    legacy = f"{VTK_HEAD}POINTS 44 double\n{places}\nPOINT_DATA 44\nSCALARS u double 1\nLOOKUP_TABLE default\n{u}\n"
    stored = io.BytesIO()
    np.savez(stored, x=X, y=Y, values=TABLE)
    return {
        "npz": [npz(points=CLOUD, values=CLOUD_U), stored.getvalue()],
        "npy": [npy(TABLE), npy(TABLE.astype("f4").T)],
        "txt": [
            csv(CLOUD[:9], CLOUD_U[:9], head="", separator=" "),
            csv(CLOUD[:9], CLOUD_U[:9], separator=" ", head="x y T\n"),
        ],
        "csv": [csv(CLOUD[:9], CLOUD_U[:9]), b"x;y;u\r\n0;0;1\r\n1;1;0\r\n0;1;2\r\n1;0;3\r\n# end"],
        "json": [json.dumps(grid).encode(), b'{"points": [[0, 0], [1, 1], [0, 1], [1, 0]], "values": [1, 2, 3, 4]}'],
        "vtu": [
            vtu({"u": ("format='ascii'", u), "Points": ("format='ascii'", places)}),
            *(written_by_meshio(folder, "vtu", compression=kind) for kind in ("zlib", "lzma", None)),
        ],
        "vtk": [legacy.encode(), *(written_by_meshio(folder, form) for form in ("vtk42", "vtk"))],
    }


@st.composite
def edited(draw: st.DrawFn, good: list[bytes], parts: list[bytes]) -> bytes:
    """One of the ``good`` files with up to six edits, or random bytes."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.binary(max_size=200))
    data = bytearray(draw(st.sampled_from(good)))
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 6]))):
        at = draw(st.integers(0, 2**20)) % (len(data) + 1)
        match draw(st.integers(0, 5)):
            case 0 | 1 if at < len(data):
                data[at] ^= 1 << draw(st.integers(0, 7))
            case 2:
                new = draw(BYTES)
                data[at : at + len(new)] = new
            case 3:
                new = draw(MIN_POINTS_FOR_THREADS | st.sampled_from(parts))
                data[at : at + draw(st.sampled_from([0, len(new)]))] = new
            case 4:
                del data[at : at + draw(st.sampled_from([1, 2, 8, 100]))]
            case _:
                if draw(st.integers(0, 3)) == 0:
                    del data[at:]
                else:
                    begin = draw(st.integers(0, 2**20)) % (len(data) + 1)
                    data[at:at] = data[begin : begin + 30]
    return bytes(data)


def watch(folder: Path) -> None:
    """End the program when a reader breaks a rule that holds for all files."""

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        name = arguments[0] if event == "open" and isinstance(arguments[0], str) else ""
        outside = (
            "/" in name
            and not name.startswith(str(folder))
            and not name.endswith((".py", ".pyc"))
            and "hypothesis" not in name
        )
        if event in FORBIDDEN or outside:
            sys.stderr.write(f"a file made its reader do {event} {arguments!r:.200}\n")
            sys.stderr.flush()
            os._exit(3)

    sys.addaudithook(hook)


@dataclass
class Report:
    """How many files of each format were read and refused, and a hash of all of them."""

    counts: Counter[str] = field(default_factory=Counter)
    digest: Any = field(default_factory=sha256)


Read: TypeAlias = Callable[[bytes], object]
"""Reads the bytes of one file."""
MOST_POINTS = 10_000


def samples_of(source: Path, suffix: str) -> Read:
    """Reads samples through a file at ``source``."""

    def read(data: bytes) -> object:
        source.write_bytes(data)
        return convert(source, f"u.{suffix}", source.with_suffix(".npz"), LIMITS, alone=True)

    return read


def mesh_of(source: Path, filename: str) -> Read:
    """Reads a mesh through a file at ``source``; what is kept is small, and can be sent in an answer."""

    def read(data: bytes) -> object:
        source.write_bytes(data)
        kept = source.with_suffix(".npz")
        summary = convert_mesh(source, filename, kept, MOST_POINTS)
        json.dumps(summary, ensure_ascii=False).encode()
        assert kept.stat().st_size < 50 * len(data) + 100_000
        return summary

    return read


def check(name: str, reads: Read, files: st.SearchStrategy[bytes], number: int, cases: int, report: Report) -> None:
    """Read this many files of one format; ``number`` is the seed."""

    @seed(number)
    @settings(max_examples=cases, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])
    @given(data=files)
    def read(data: bytes) -> None:
        report.digest.update(data)
        started = time.process_time()
        message = ""
        try:
            reads(data)
        except InputError as error:
            message = error.message
            assert_sentence(message)
        report.counts[f"{name} {'refused' if message else 'read'}"] += 1
        assert time.process_time() - started < MOST_SECONDS

    read()


def assert_sentence(message: str) -> None:
    assert 10 < len(message) < 1000, message
    message.encode()


def main(folder: Path, cases: int, number: int) -> None:
    good, source = good_files(folder), folder / "source"
    meshes = {f"mesh, {kind}": found for kind, found in good_meshes(folder).items()}
    assert {*good} == {*READERS}
    readers = {suffix: samples_of(source, suffix) for suffix in READERS}
    readers |= {kind: mesh_of(source, name) for kind, (name, _) in meshes.items()}
    strategies = {suffix: edited(good[suffix], PARTS[suffix]) for suffix in READERS}
    strategies |= {kind: edited(files, MESH_PARTS) for kind, (_, files) in meshes.items()}
    for name, files in {**good, **{kind: files for kind, (_, files) in meshes.items()}}.items():
        for data in files:
            if not name.endswith(("bz2", "lzma")):  # these packings are refused
                readers[name](data)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    address_space = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (address_space + MEMORY,) * 2)
    warnings.simplefilter("error")
    report = Report()
    watch(folder)

    for name, reads in readers.items():
        check(name, reads, strategies[name], number, cases, report)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - used
    print(json.dumps({"counts": report.counts, "grown": grown, "digest": report.digest.hexdigest()[:16]}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
