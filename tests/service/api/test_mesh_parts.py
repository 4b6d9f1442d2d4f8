"""Meshes in parts over HTTP: the manifest, the files of the parts, the head, and who may see them."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh_cluster.part_files.parted_mesh import read_parts
from equimesh_service import Settings
from equimesh_service.worker.part_formats import HEADED, PART_FORMATS
from service.conftest import SLOW, small
from service.guarded import Guarded
from service.parts import SHAPE, TRAFFIC, bent_mesh, store_in_parts, u_of
from service.requests import post


@pytest.fixture(scope="module")
def mesh(http: httpx.Client, settings: Settings) -> dict[str, Any]:
    """A finished mesh in parts."""
    found: dict[str, Any] = http.get(f"/v1/meshes/{store_in_parts(settings)}").json()
    return found


def test_a_mesh_says_that_it_is_in_parts(mesh: dict[str, Any], finished: dict[str, Any]) -> None:
    assert mesh["parts"] == {"count": 3, **TRAFFIC}
    assert mesh["links"]["parts"].endswith(f"{mesh['id']}/parts")
    assert (finished["parts"], "parts" in finished["links"]) == (None, False)


@pytest.mark.parametrize("format", HEADED)
def test_all_files_of_the_manifest_are_one_mesh(
    http: httpx.Client, mesh: dict[str, Any], format: str, tmp_path: Path
) -> None:
    manifest = http.get(mesh["links"]["parts"], params={"format": format}).json()
    assert [(part["number"], part["first"], part["last"], part["rows"]) for part in manifest["parts"]] == [
        (0, 0, 6, 7),
        (1, 6, 12, 7),
        (2, 12, 17, 5),
    ]
    assert (manifest["count"], manifest["formats"], manifest["grid"]) == (3, [*PART_FORMATS], {"n_xi": 17, "n_eta": 9})
    for file in (*(part["file"] for part in manifest["parts"]), manifest["head"]):
        answer = http.get(file["href"])
        assert (answer.status_code, answer.headers["content-type"]) == (200, file["media_type"])
        path = tmp_path / file["name"]
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(answer.content)
    whole, found = bent_mesh(), read_parts(tmp_path / manifest["head"]["name"])
    np.testing.assert_array_equal(found.rows("x", 0, SHAPE[0]), whole.x)
    np.testing.assert_array_equal(found.rows("u", 0, SHAPE[0]), u_of(whole.x, whole.y))
    again = http.get(mesh["links"]["parts"], params={"format": format}).json()  # all files are made now
    for file in (*(part["file"] for part in again["parts"]), again["head"]):
        content = (tmp_path / file["name"]).read_bytes()
        assert (file["size"], file["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    assert again["size"] == sum(path.stat().st_size for path in tmp_path.rglob("*.*") if path.is_file())


def test_a_part_can_be_cached_and_resumed(http: httpx.Client, mesh: dict[str, Any]) -> None:
    url = f"{mesh['links']['parts']}/1"
    whole = http.get(url)
    etag = whole.headers["etag"]
    assert etag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert whole.headers["content-disposition"] == 'attachment; filename="part-0001.vtu"'
    assert http.get(url, headers={"If-None-Match": etag}).status_code == 304
    assert http.get(url, headers={"If-Match": '"other"'}).status_code == 412
    part = http.get(url, headers={"Range": "bytes=10-19", "If-Range": etag})
    assert (part.status_code, part.content) == (206, whole.content[10:20])
    head = http.head(url)
    assert (head.status_code, head.content, head.headers["etag"]) == (200, b"", etag)


def test_the_arrays_of_a_part(http: httpx.Client, mesh: dict[str, Any]) -> None:
    with np.load(io.BytesIO(http.get(f"{mesh['links']['parts']}/2?format=npz").content)) as file:
        np.testing.assert_array_equal(file["y"], bent_mesh().y[12:])
    manifest = http.get(mesh["links"]["parts"], params={"format": "npz"}).json()
    assert manifest["head"] is None


def test_a_mesh_in_parts_is_its_head_in_one_file(http: httpx.Client, mesh: dict[str, Any]) -> None:
    file = mesh["links"]["file"]
    assert http.get(file).headers["content-type"] == PART_FORMATS["pvtu"].head_media_type
    assert http.get(file).headers["content-disposition"] == f'attachment; filename="{mesh["id"]}.pvtu"'
    by_accept = http.get(file, headers={"Accept": PART_FORMATS["pvtu"].head_media_type})
    assert b"PUnstructuredGrid" in by_accept.content


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("/file?format=vtu", 406, "A mesh in parts is no vtu file. Request one of pvtu, vtkhdf."),
        ("/file?format=pvtu&cells=triangle", 406, "hold quadrilaterals"),
        ("/file?format=pvtx", 406, "did you mean 'pvtu'"),
        ("/parts?format=vtu", 406, "is not a format of parts"),
        ("/parts/3", 404, "The mesh has 3 parts, with the numbers 0 to 2."),
        ("/parts/-1", 422, ""),
        ("/plot", 406, "There is no picture of a mesh in parts."),
        ("/quality?arrays=true", 406, "There is no quality of each cell of a mesh in parts."),
    ],
)
def test_what_a_mesh_in_parts_has_not(
    http: httpx.Client, mesh: dict[str, Any], path: str, status: int, words: str
) -> None:
    answer = http.get(f"/v1/meshes/{mesh['id']}{path}")
    assert answer.status_code == status, answer.text
    assert words in answer.json()["detail"]


def test_a_whole_mesh_has_no_parts(http: httpx.Client, finished: dict[str, Any]) -> None:
    here = f"/v1/meshes/{finished['id']}"
    for path in ("/parts", "/parts/0"):
        answer = http.get(here + path)
        assert (answer.status_code, answer.json()["detail"]) == (404, "This mesh is whole, and has no parts.")
    head = http.get(f"{here}/file?format=pvtu")
    assert head.status_code == 406
    assert "this mesh is whole" in head.json()["detail"]
    assert post(http, small(), "?format=pvtu").status_code == 406


def test_parts_of_an_unfinished_mesh(http: httpx.Client) -> None:
    mesh = post(http, SLOW).json()
    try:
        answer = http.get(f"/v1/meshes/{mesh['id']}/parts")
        assert (answer.status_code, answer.json()["type"]) == (409, "/problems/not-finished")
    finally:
        http.delete(mesh["links"]["self"])


def test_parts_belong_to_their_key(guarded_service: Guarded) -> None:
    key, secret = guarded_service.key("write")
    mesh = store_in_parts(guarded_service.settings, key.id)
    paths = (f"/v1/meshes/{mesh}/parts", f"/v1/meshes/{mesh}/parts/0", f"/v1/meshes/{mesh}/file?format=pvtu")
    with guarded_service.having(secret) as owner, guarded_service.client("write") as other:
        assert [owner.get(path).status_code for path in paths] == [200, 200, 200]
        assert [other.get(path).status_code for path in paths] == [404, 404, 404]
        stored = guarded_service.store.quotas.stored_bytes(key.id)
        assert stored > owner.get(paths[0]).json()["size"]
        assert owner.delete(f"/v1/meshes/{mesh}").status_code == 204
        assert guarded_service.store.quotas.stored_bytes(key.id) == 0
        assert owner.get(paths[1]).status_code == 404
