"""Requests in one npz: the spec is taken out, and the other arrays are the samples."""

from __future__ import annotations

import io
import json
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh_service.assembly.bodies import unpack
from equimesh_service.problems.problem import Problem

SPEC = {"monitor": {"kind": "arc_length", "u": {"samples": "upload"}}, "grid": {"n_xi": 9, "n_eta": 9}, "label": "é"}
AXIS = np.linspace(0.0, 1.0, 9)
SAMPLES = {"x": AXIS, "y": AXIS, "values": np.tanh(5 * np.add.outer(AXIS, -AXIS))}


def packed(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    "text",
    [
        np.array(json.dumps(SPEC)),
        np.array([json.dumps(SPEC)]),
        np.array(json.dumps(SPEC).encode()),
        np.frombuffer(json.dumps(SPEC, ensure_ascii=False).encode(), np.uint8),
    ],
)
def test_the_spec_is_a_text_or_its_bytes(text: Any) -> None:
    data = packed(spec=text, **SAMPLES)
    spec, upload = unpack(data)
    assert json.loads(spec) == SPEC
    assert upload is not None
    assert (upload.data, upload.filename) == (data, "samples.npz")


def test_a_spec_alone_has_no_samples() -> None:
    assert unpack(packed(spec=json.dumps(SPEC)))[1] is None


@pytest.mark.parametrize(
    ("data", "kind", "said"),
    [
        (packed(**SAMPLES), "malformed-body", "no array 'spec'"),
        (b"not a zip", "invalid-input", "npz"),
        (packed(spec=np.array([1.5, 2.5])), "invalid-input", "one text"),
        (packed(spec=np.array(["a", "b"])), "invalid-input", "one text"),
        (packed(spec=np.array([None], dtype=object)), "invalid-input", "one text"),
        (packed(spec=np.arange(4, dtype=np.uint16)), "invalid-input", "one text"),
        (packed(spec="ab").replace(b"<U2", b"<U9"), "invalid-input", "npz"),
        (packed(spec="x" * 2_000_000), "invalid-input", "more than the bytes allowed"),
    ],
)
def test_what_is_wrong_is_said(data: bytes, kind: str, said: str) -> None:
    with pytest.raises(Problem) as caught:
        unpack(data)
    assert caught.value.name == kind
    assert said in str(caught.value.body())


def test_the_service_makes_the_same_mesh_of_both_forms(http: httpx.Client) -> None:
    headers = {"Prefer": "wait=30"}
    body = packed(spec=json.dumps(SPEC), **SAMPLES)
    sent = {"spec": (None, json.dumps(SPEC), "application/json"), "samples": ("u.npz", packed(**SAMPLES))}
    path = "/v1/meshes?format=npz&reuse=false"
    one = http.post(path, content=body, headers={**headers, "Content-Type": "application/x-npz"})
    two = http.post(path, files=sent, headers=headers)
    assert (one.status_code, two.status_code) == (201, 201)
    assert one.headers["etag"] == two.headers["etag"]
    names = [part.partition(";")[0] for part in one.headers["server-timing"].split(", ")]
    assert {"receive", "check", "solve", "quality", "commit", "answer"} <= {*names}
