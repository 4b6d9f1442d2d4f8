"""Downloads of meshes in parts, from a service that misbehaves; for both clients."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_client import BadArgument, DownloadDamaged

HEAD = b'<Piece Source="m/part-0000.vtu"/><Piece Source="m/part-0001.vtu"/>'
PARTS = [("m/part-0000.vtu", b"first " * 500), ("m/part-0001.vtu", b"second " * 500), ("m.pvtu", HEAD)]


@pytest.fixture
def mesh(connect: Any, service: Any) -> Any:
    service.parted = [*PARTS]
    return connect(service.url).generate("x*y", (5, 4))


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_all_files_arrive_under_their_names(mesh: Any, tmp_path: Path) -> None:
    assert mesh.download_parts(tmp_path) == tmp_path / "m.pvtu"
    assert files_in(tmp_path) == dict(PARTS)


def test_the_head_takes_the_name_of_the_download(mesh: Any, tmp_path: Path) -> None:
    assert mesh.download(tmp_path / "mine.pvtu") == tmp_path / "mine.pvtu"
    files = {f"mine/{name.partition('/')[2]}": data for name, data in PARTS[:2]}
    assert files_in(tmp_path) == {**files, "mine.pvtu": PARTS[2][1].replace(b"m/part", b"mine/part")}
    mesh.download(tmp_path / "a & b.pvtu")
    assert b'Source="a &amp; b/part-0000.vtu"' in (tmp_path / "a & b.pvtu").read_bytes()


def test_files_that_are_there_are_not_sent_again(mesh: Any, service: Any, tmp_path: Path) -> None:
    mesh.download_parts(tmp_path)
    (tmp_path / "m" / "part-0001.vtu").write_bytes(b"SECOND " * 500)  # as long as the right one
    service.requests.clear()
    mesh.download_parts(tmp_path)
    assert [request.path.rpartition("/")[2] for request in service.requests] == ["parts", "1"]
    assert files_in(tmp_path) == dict(PARTS)


def test_a_cut_line_is_taken_up_again(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("GET .*/parts/1$", "cut", cut=1000)]
    mesh.download_parts(tmp_path)
    assert files_in(tmp_path) == dict(PARTS)
    assert [request.headers.get("range") for request in service.seen("GET", "parts/1")] == [None, "bytes=1000-"]


def test_wrong_bytes_are_noticed_and_not_kept(mesh: Any, service: Any, fault: Any, tmp_path: Path) -> None:
    service.faults = [fault("GET .*/parts/0$", "damage", times=2)]
    with pytest.raises(DownloadDamaged):
        mesh.download_parts(tmp_path)
    assert files_in(tmp_path) == {}


def test_the_checksum_of_the_list_counts(mesh: Any, service: Any, tmp_path: Path) -> None:
    manifest = mesh.parts()
    assert (manifest.count, manifest.parts[1].file.size) == (2, len(PARTS[1][1]))
    listed = [*PARTS]

    class Swapped(list[Any]):
        """Another file than the one that is listed, when it is fetched by its number."""

        def __getitem__(self, number: Any) -> Any:
            return ("m/part-0000.vtu", b"another") if number == 0 else listed[number]

    service.parted = Swapped(listed)
    with pytest.raises(DownloadDamaged, match=r"part-0000.vtu does not have the checksum of the list"):
        mesh.download_parts(tmp_path)
    assert files_in(tmp_path) == {}


@pytest.mark.parametrize("name", ["../part-0000.vtu", "/part", "m/../../part", "a/b/c", "", ".hidden", "m\\part"])
def test_no_name_leads_out_of_the_folder(mesh: Any, service: Any, tmp_path: Path, name: str) -> None:
    service.parted = [(name, b"x"), *PARTS[1:]]
    folder = tmp_path / "inner"
    folder.mkdir()
    with pytest.raises(DownloadDamaged, match="is not the name of a file of a mesh"):
        mesh.download_parts(folder)
    assert files_in(tmp_path) == {}


def test_the_arrays_of_a_part(mesh: Any, service: Any) -> None:
    npz = io.BytesIO()
    np.savez(npz, x=np.ones((3, 4)), y=np.zeros((3, 4)))
    service.parted[1] = ("m/part-0001.npz", npz.getvalue())
    part = mesh.part(1)
    assert (part.number, part.first, part.last, part.x.shape, part.u) == (1, 2, 4, (3, 4), None)
    with pytest.raises(DownloadDamaged, match="cannot be read"):
        mesh.part(0)
    with pytest.raises(BadArgument, match="numbers 0 to 1, not 2"):
        mesh.part(2)


def test_arguments_that_cannot_be_used(mesh: Any, tmp_path: Path) -> None:
    with pytest.raises(BadArgument, match="there is no such folder"):
        mesh.download_parts(tmp_path / "nowhere")
    with pytest.raises(BadArgument, match="has no head in the format npz"):
        mesh.download_parts(tmp_path, "npz")
