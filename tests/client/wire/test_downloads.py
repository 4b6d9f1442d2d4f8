"""Downloads, also in parts, over lines that break, from services that lie: whole, and no byte fetched twice."""

from __future__ import annotations

import hashlib
import io
import os
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_client import (
    BadArgument,
    Client,
    DeadlineExceeded,
    DownloadDamaged,
    NotFound,
    RetryPolicy,
    ServiceUnreachable,
)
from equimesh_client.wire.downloads import FOAM_FILES, unpack_foam, unpack_xdmf, write_atomically

DATA = bytes(range(251)) * 400  # longer than a socket's pieces, and no two parts alike


@pytest.fixture
def mesh(connect: Any, service: Any) -> Any:
    service.file = DATA
    return connect(service.url, retries=RetryPolicy(retries=2, first=0.001)).generate("x", 5)


def part(folder: Path, data: bytes = DATA, name: str = "m.vtu") -> Path:
    return folder / f".{name}.{hashlib.sha256(data).hexdigest()}.part"


def requested_ranges(service: Any) -> list[str | None]:
    """The requested ranges, one for each request."""
    return [request.headers.get("range") for request in service.seen("GET", "file")]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_every_attempt_asks_for_the_rest_only(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    # five breaks and two retries: an attempt that brings something is none of the failures in a row
    service.faults = [fault("file", "cut", cut=cut) for cut in (1000, 1, 20_000, 7, 70_000)]
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
    assert requested_ranges(service) == [None, *(f"bytes={at}-" for at in (1000, 1001, 21_001, 21_008, 91_008))]
    etag = f'"{hashlib.sha256(DATA).hexdigest()}"'
    assert [r.headers.get("if-range") for r in service.seen("GET", "file")] == [None, *[etag] * 5]
    assert {r.headers["accept-encoding"] for r in service.seen("GET", "file")} == {"identity"}
    assert names(tmp_path) == ["m.vtu"]


def test_arrays_go_on_in_memory(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("file", "cut", cut=100), fault("file", "cut", cut=200)]
    assert mesh.x.shape == (5, 5)
    assert requested_ranges(service) == [None, "bytes=100-", "bytes=300-"]


def test_a_file_that_changes_in_between_begins_anew(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("file", "cut", cut=5000), fault("file", "status")]
    flow = iter([DATA, DATA, DATA[::-1]])
    real = service.fault

    def change(method: str, path: str) -> Any:
        if path.endswith("/file"):
            service.file = next(flow)
        return real(method, path)

    service.fault = change
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA[::-1]
    assert requested_ranges(service) == [None, "bytes=5000-", "bytes=5000-"]
    assert names(tmp_path) == ["m.vtu"]


@pytest.mark.parametrize(
    ("action", "ranges"),
    [
        ("longer", [None]),  # all bytes are there, by the checksum, when the line breaks
        ("shorter", [None, None]),  # seems complete but is not: the rest cannot be distinguished from damage
        ("elsewhere", [None, None]),
        ("damage", [None, None]),
    ],
)
def test_a_lie_does_not_get_into_the_file(
    mesh: Any, service: Any, fault: Any, tmp_path: Path, action: str, ranges: list[str | None]
) -> None:
    service.faults = [fault("file", action)]
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
    assert requested_ranges(service) == ranges
    assert names(tmp_path) == ["m.vtu"]


def test_a_206_of_other_bytes_is_not_appended(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("file", "cut", cut=5000), fault("file", "elsewhere")]
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
    assert requested_ranges(service) == [None, "bytes=5000-", None]


@pytest.mark.parametrize(("ranges", "etags"), [(False, '"{}"'), (True, 'W/"{}"')])
def test_a_service_without_ranges_gets_no_endless_retries(
    mesh: Any, service: Any, fault: Any, tmp_path: Path, ranges: bool, etags: str
) -> None:
    service.ranges, service.etags = ranges, etags
    service.faults = [fault("file", "cut", cut=5000)]
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
    service.faults = [fault("file", "cut", cut=5000, times=99)]
    service.requests.clear()
    with pytest.raises(ServiceUnreachable):
        mesh.download(tmp_path / "m.vtu")
    assert len(service.requests) == 3


def test_what_an_earlier_program_left_is_gone_on_with(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("file", "cut", cut=5000), fault("file", times=99)]
    with pytest.raises(ServiceUnreachable):
        mesh.download(tmp_path / "m.vtu")
    assert names(tmp_path) == [part(tmp_path).name]
    service.faults, service.requests[:] = [], []
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
    assert requested_ranges(service) == ["bytes=5000-"]
    assert names(tmp_path) == ["m.vtu"]
    # one that is whole needs no request; one of other bytes, or longer than the file, is thrown away
    part(tmp_path).write_bytes(DATA)
    assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
    assert len(requested_ranges(service)) == 1
    for wrong in (DATA + b"more", b"wrong" * 1000):
        part(tmp_path).write_bytes(wrong)
        part(tmp_path, b"another").write_bytes(b"old")
        os.utime(part(tmp_path, b"another"), (1, 1))
        part(tmp_path, name="other.vtu").write_bytes(b"not ours")
        assert mesh.download(tmp_path / "m.vtu").read_bytes() == DATA
        assert names(tmp_path) == [part(tmp_path, name="other.vtu").name, "m.vtu"]


def test_a_deadline_leaves_the_part(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("file", "cut", cut=5000), fault("file", "late", times=9)]
    with pytest.raises(DeadlineExceeded):
        mesh.download(tmp_path / "m.vtu", deadline=1.5)
    assert part(tmp_path).read_bytes() == DATA[:5000]
    service.faults = [fault("file", "status", status=404)]
    with pytest.raises(NotFound):
        mesh.download(tmp_path / "m.vtu")
    assert names(tmp_path) == []  # nothing will ever come of it


def test_damage_leaves_nothing(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("file", "damage", times=9)]
    with pytest.raises(DownloadDamaged):
        mesh.download(tmp_path / "m.vtu")
    assert names(tmp_path) == []


def test_a_killed_program_and_two_at_the_same_time(service: Any, fault: Any, tmp_path: Path) -> None:
    service.file, path = DATA, tmp_path / "m.vtu"
    code = (
        f"import equimesh_client as e; e.Client({service.url!r}, retries=99).meshes.get('m0').download({str(path)!r})"
    )
    with Client(service.url, retries=0) as client:
        mesh = client.generate("x", 5)
        service.faults = [fault("file", "cut", cut=60_000), fault("file", "late")]
        with subprocess.Popen([sys.executable, "-c", code]) as other:
            try:
                while len(requested_ranges(service)) < 2:
                    assert other.poll() is None
                    time.sleep(0.02)
                # the other program holds its part: this one fetches all of it, and leaves that part alone
                assert mesh.download(path).read_bytes() == DATA
                assert requested_ranges(service)[-1] is None
                assert names(tmp_path) == [part(tmp_path).name, "m.vtu"]
            finally:
                other.kill()
        path.unlink()
        assert mesh.download(path).read_bytes() == DATA
        assert str(requested_ranges(service)[-1]).startswith("bytes=")
        assert names(tmp_path) == ["m.vtu"]


# The four files of an XDMF mesh, and the five of an OpenFOAM mesh.


def archive(*names: str) -> bytes:
    """A zip of these files, each with a reference to the heavy data of its part."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as made:
        for name in names:
            made.writestr(name, f"{name.partition('.')[0]}.h5:/0")
    return file.getvalue()


def test_xdmf_is_unpacked_under_its_own_name(connect: Any, service: Any, tmp_path: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    assert mesh.download(tmp_path / "a.xdmf") == tmp_path / "a.xdmf"
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {
        "a.xdmf": "<DataItem>a.h5:/data0</DataItem>",
        "a.h5": "mesh",
        "a_facets.xdmf": "<DataItem>a_facets.h5:/data0</DataItem>",
        "a_facets.h5": "facets",
    }
    assert mesh.download(tmp_path / "a.xdmf.zip").read_bytes()[:2] == b"PK"


@pytest.mark.parametrize("data", [b"", b"no zip", archive("mesh.h5", "mesh.xdmf")])
def test_an_archive_without_its_files_writes_nothing(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(DownloadDamaged, match="XDMF archive"):
        unpack_xdmf(data, tmp_path / "m.xdmf")
    assert list(tmp_path.iterdir()) == []


def test_foam_is_unpacked_into_a_case_whose_other_files_stay(connect: Any, service: Any, tmp_path: Path) -> None:
    (tmp_path / "system").mkdir()
    (tmp_path / "system" / "controlDict").write_text("mine")
    mesh = connect(service.url).generate("x", 5)
    assert mesh.download(tmp_path) == mesh.download(tmp_path, "foam") == tmp_path
    found = {path.relative_to(tmp_path).as_posix(): path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert found.pop("system/controlDict") == "mine"
    assert found == {name: name for name in FOAM_FILES}
    assert mesh.download(tmp_path / "a.foam.zip").read_bytes()[:2] == b"PK"


@pytest.mark.parametrize("data", [b"no zip", archive(*FOAM_FILES[1:])])
def test_an_incomplete_foam_mesh_writes_nothing(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(DownloadDamaged, match="OpenFOAM archive"):
        unpack_foam(data, tmp_path)
    assert list(tmp_path.iterdir()) == []


# Files that appear whole or not at all.


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"old")
    assert write_atomically(tmp_path / "a", b"new") == tmp_path / "a"
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"new"}


def test_a_failure_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / "a").write_bytes(b"old")
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(BadArgument, match="No space left"):
        write_atomically(tmp_path / "a", b"new")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"old"}


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(BadArgument, match="is a folder"):
        write_atomically(tmp_path, b"")
    with pytest.raises(BadArgument, match="No such file"):
        write_atomically(tmp_path / "no" / "where", b"")


HEAD = b'<Piece Source="m/part-0000.vtu"/><Piece Source="m/part-0001.vtu"/>'
PARTS = [("m/part-0000.vtu", b"first " * 500), ("m/part-0001.vtu", b"second " * 500), ("m.pvtu", HEAD)]


@pytest.fixture
def parted_mesh(connect: Any, service: Any) -> Any:
    service.parted = [*PARTS]
    return connect(service.url).generate("x*y", (5, 4))


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_all_files_arrive_under_their_names(parted_mesh: Any, tmp_path: Path) -> None:
    assert parted_mesh.download_parts(tmp_path) == tmp_path / "m.pvtu"
    assert files_in(tmp_path) == dict(PARTS)


def test_the_head_takes_the_name_of_the_download(parted_mesh: Any, tmp_path: Path) -> None:
    assert parted_mesh.download(tmp_path / "mine.pvtu") == tmp_path / "mine.pvtu"
    files = {f"mine/{name.partition('/')[2]}": data for name, data in PARTS[:2]}
    assert files_in(tmp_path) == {**files, "mine.pvtu": PARTS[2][1].replace(b"m/part", b"mine/part")}
    parted_mesh.download(tmp_path / "a & b.pvtu")
    assert b'Source="a &amp; b/part-0000.vtu"' in (tmp_path / "a & b.pvtu").read_bytes()


def test_files_that_are_there_are_not_sent_again(parted_mesh: Any, service: Any, tmp_path: Path) -> None:
    parted_mesh.download_parts(tmp_path)
    (tmp_path / "m" / "part-0001.vtu").write_bytes(b"SECOND " * 500)  # as long as the right one
    service.requests.clear()
    parted_mesh.download_parts(tmp_path)
    assert [request.path.rpartition("/")[2] for request in service.requests] == ["parts", "1"]
    assert files_in(tmp_path) == dict(PARTS)


def test_a_cut_line_is_taken_up_again(parted_mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("GET .*/parts/1$", "cut", cut=1000)]
    parted_mesh.download_parts(tmp_path)
    assert files_in(tmp_path) == dict(PARTS)
    assert [request.headers.get("range") for request in service.seen("GET", "parts/1")] == [None, "bytes=1000-"]


def test_wrong_bytes_are_noticed_and_not_kept(parted_mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("GET .*/parts/0$", "damage", times=2)]
    with pytest.raises(DownloadDamaged):
        parted_mesh.download_parts(tmp_path)
    assert files_in(tmp_path) == {}


def test_the_checksum_of_the_list_counts(parted_mesh: Any, service: Any, tmp_path: Path) -> None:
    manifest = parted_mesh.parts()
    assert (manifest.count, manifest.parts[1].file.size) == (2, len(PARTS[1][1]))
    listed = [*PARTS]

    class Swapped(list[Any]):
        """Another file than the one that is listed, when it is fetched by its number."""

        def __getitem__(self, number: Any) -> Any:
            return ("m/part-0000.vtu", b"another") if number == 0 else listed[number]

    service.parted = Swapped(listed)
    with pytest.raises(DownloadDamaged, match=r"part-0000.vtu does not have the checksum of the list"):
        parted_mesh.download_parts(tmp_path)
    assert files_in(tmp_path) == {}


@pytest.mark.parametrize("name", ["../part-0000.vtu", "/part", "m/../../part", "a/b/c", "", ".hidden", "m\\part"])
def test_no_name_leads_out_of_the_folder(parted_mesh: Any, service: Any, tmp_path: Path, name: str) -> None:
    service.parted = [(name, b"x"), *PARTS[1:]]
    folder = tmp_path / "inner"
    folder.mkdir()
    with pytest.raises(DownloadDamaged, match="is not the name of a file of a mesh"):
        parted_mesh.download_parts(folder)
    assert files_in(tmp_path) == {}


def test_the_arrays_of_a_part(parted_mesh: Any, service: Any) -> None:
    npz = io.BytesIO()
    np.savez(npz, x=np.ones((3, 4)), y=np.zeros((3, 4)))
    service.parted[1] = ("m/part-0001.npz", npz.getvalue())
    part = parted_mesh.part(1)
    assert (part.number, part.first, part.last, part.x.shape, part.u) == (1, 2, 4, (3, 4), None)
    with pytest.raises(DownloadDamaged, match="cannot be read"):
        parted_mesh.part(0)
    with pytest.raises(BadArgument, match="numbers 0 to 1, not 2"):
        parted_mesh.part(2)


def test_arguments_that_cannot_be_used(parted_mesh: Any, tmp_path: Path) -> None:
    with pytest.raises(BadArgument, match="there is no such folder"):
        parted_mesh.download_parts(tmp_path / "nowhere")
    with pytest.raises(BadArgument, match="has no head in the format npz"):
        parted_mesh.download_parts(tmp_path, "npz")
