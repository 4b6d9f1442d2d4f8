"""A service with its files in S3, also while S3 is down."""

from __future__ import annotations

import hashlib
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr

from equimesh_service import Settings, running
from service.conftest import small, until
from service.s3_server import ACCESS_KEY, SECRET_KEY, S3Server, serving


def test_a_service_that_keeps_its_files_in_s3(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    with serving(tmp_path_factory.mktemp("s3")) as s3:
        bucket = s3.bucket("meshes")
        settings = Settings(
            data_dir=tmp_path,
            port=0,
            workers=1,
            log_level="error",
            files_url="s3://meshes/all",
            s3_endpoint=s3.endpoint,
            s3_access_key=SecretStr(ACCESS_KEY),
            s3_secret_key=SecretStr(SECRET_KEY),
            reuse=False,
        )
        with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
            _use(http, s3, bucket)


# A mesh whose files have more than 1 MiB, and are in the bucket.
LARGE = {"n_xi": 260, "n_eta": 260}


def _many() -> bytes:
    """Samples of more than 1 MiB."""
    rows = (f"{x},{y},{x * y % 97}" for x in range(380) for y in range(380))
    return "\n".join(["x,y,u", *rows]).encode()


def _use(http: httpx.Client, s3: S3Server, bucket: Path) -> None:
    def objects() -> set[str]:
        return {path.name for path in bucket.rglob("*") if path.is_file()}

    x = [k / 16 for k in range(17)]
    samples = http.post("/v1/samples", json={"grid": {"x": x, "y": x, "values": [[a * b for b in x] for a in x]}})
    assert samples.status_code == 201, samples.text
    name = samples.json()["id"]
    assert http.get(f"/v1/samples/{name}?format=npz").status_code == 200
    spec = {"monitor": {"kind": "curvature", "u": {"samples": name}}, "grid": LARGE}
    mesh = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}).json()
    assert mesh["status"] == "succeeded", mesh["error"]
    whole = http.get(mesh["links"]["file"])
    etag = whole.headers["etag"]
    assert etag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    first = http.get(mesh["links"]["file"], headers={"Range": "bytes=0-99"})
    rest = http.get(mesh["links"]["file"], headers={"Range": "bytes=100-", "If-Range": etag})
    assert (first.status_code, rest.status_code) == (206, 206)
    assert first.content + rest.content == whole.content
    assert http.get(mesh["links"]["file"], headers={"If-None-Match": etag}).status_code == 304
    assert etag.strip('"') in objects()
    before = objects()
    other = http.post("/v1/meshes", json=small(grid=LARGE), headers={"Prefer": "wait=300"}).json()
    unnamed = objects() - before

    s3.kill()
    before = objects()
    asked = http.post("/v1/meshes", json=small(grid=LARGE), headers={"Prefer": "wait=300"})
    assert (asked.status_code, asked.json()["status"]) == (201, "failed")  # three attempts, none of them half there
    assert "could not be reached" in asked.json()["error"]["detail"]
    for down in (
        http.get(mesh["links"]["file"]),
        http.get(mesh["links"]["file"], params={"format": "msh"}),
        http.post("/v1/samples", content=_many(), headers={"Content-Type": "text/csv"}),
    ):
        assert (down.status_code, down.json()["type"]) == (503, "/problems/unavailable"), down.text
        assert down.headers["retry-after"]
    tiny = http.post("/v1/meshes", json=small(), headers={"Prefer": "wait=300"}).json()  # which needs no bucket
    assert tiny["status"] == "succeeded"
    assert http.get(tiny["links"]["file"]).status_code == 200
    assert http.delete(other["links"]["self"]).status_code == 204  # the sweep removes its files
    ready = http.get("/readyz")
    assert (ready.status_code, ready.json()["checks"]["store"]) == (503, "ok")
    assert "cannot be used" in ready.json()["checks"]["files"]
    s3.start()
    assert objects() == before

    until(lambda: http.get("/readyz").status_code == 200)
    assert http.get(mesh["links"]["file"]).content == whole.content
    assert http.get(mesh["links"]["file"], params={"format": "msh"}).status_code == 200
    assert http.delete(mesh["links"]["self"]).status_code == 204
    assert http.delete(asked.json()["links"]["self"]).status_code == 204
    assert http.delete(f"/v1/samples/{name}").status_code == 204
    assert objects() == unnamed
