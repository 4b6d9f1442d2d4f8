"""Uploads of every format, broken at random: read, or refused with a sentence, in bounded memory and time.

``FUZZ_CASES`` sends more, and ``FUZZ_SEED`` others.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import httpx

from equimesh.upload.samples import READERS
from fuzz.conftest import chosen_seed, count_cases
from service.conftest import small, until

FEW = 100
KINDS = 18
"""Formats of samples, and kinds of mesh files."""
TESTS = Path(__file__).parents[1]
# A long run takes minutes of processor time, and more where other programs run.
LONG_SECONDS = 7200


def test_readers_survive_any_file(tmp_path: Path) -> None:
    cases = max(FEW, count_cases(0) // KINDS)
    command = [
        sys.executable,
        "-X",
        "faulthandler",
        "-m",
        "fuzz.broken_files",
        str(tmp_path),
        str(cases),
        str(chosen_seed()),
    ]
    environment = {**os.environ, "PYTHONPATH": str(TESTS), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=LONG_SECONDS)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    report = json.loads(done.stdout)
    counts = report["counts"]
    names = {name.rpartition(" ")[0] for name in counts}
    assert len(names) == KINDS
    for name in names:
        refused, read = counts[f"{name} refused"], counts.get(f"{name} read", 0)
        assert refused + read >= cases
        assert refused > cases / 5, name
        assert read > 0 or name.endswith(("bz2", "lzma")), name  # not all is refused at the door
    print(f"files: seed {chosen_seed()}, {sum(counts.values())} files, digest {report['digest']}")
    assert report["grown"] < 150 * 2**20


def test_broken_uploads_over_http(fuzz_http: httpx.Client) -> None:
    for suffix in READERS:
        for data in (b"", b"\x00" * 1000, b"PK\x03\x04" + bytes(60), b"\x93NUMPY\x01\x00\xff\xff", b"<!DOCTYPE a><a/>"):
            answer = fuzz_http.post("/v1/samples", params={"filename": f"u.{suffix}"}, content=data)
            assert answer.status_code == 422, (suffix, data[:10], answer.text)
            answer = fuzz_http.post("/v1/samples", files={"samples": (f"../../u.{suffix}", data)})
            assert answer.status_code == 422, (suffix, data[:10], answer.text)
    assert fuzz_http.get("/readyz").status_code == 200


def test_a_mesh_comes_back_as_samples(fuzz_http: httpx.Client) -> None:
    mesh = fuzz_http.post("/v1/meshes", json=small(), headers={"Prefer": "wait=30"}).json()
    until(lambda: fuzz_http.get(mesh["links"]["self"]).json()["status"] == "succeeded")
    for form in ("vtu", "vtk"):
        file = fuzz_http.get(mesh["links"]["file"], params={"format": form})
        kind = {"Content-Type": file.headers["content-type"]}
        stored = fuzz_http.post("/v1/samples", content=file.content, headers=kind)
        assert stored.status_code in (200, 201), stored.text
        assert (stored.json()["kind"], stored.json()["shape"]) == ("scattered", [72])
