"""Bodies that are refused: not JSON, too large, of a wrong type, or broken multipart."""

from __future__ import annotations

import httpx
import pytest

MALFORMED: dict[str, bytes] = {
    "nothing": b"",
    "half an object": b'{"monitor": ',
    "not UTF-8": b'{"label": "\xff"}',
    "UTF-16": '{"monitor": 1}'.encode("utf-16"),
    "twice a key": b'{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "grid": {"n_xi": 8, "n_xi": 9}}',
    "deep lists": b"[" * 200_000,
    "deep objects": b'{"a":' * 100_000,
    "text": b"hello",
    "a comment": b"{} // no",
}


@pytest.mark.parametrize("name", MALFORMED)
def test_what_is_not_json_is_a_400(http: httpx.Client, name: str) -> None:
    answer = http.post("/v1/meshes", content=MALFORMED[name], headers={"Content-Type": "application/json"})
    assert answer.status_code == 400, answer.text
    assert answer.json()["type"] == "/problems/malformed-body"


def test_the_type_of_the_body_counts(http: httpx.Client) -> None:
    for headers in (
        {"Content-Type": "text/plain"},
        {},
        {"Content-Type": "application/json", "Content-Encoding": "gzip"},
    ):
        answer = http.post("/v1/meshes", content=b"{}", headers=headers)
        assert answer.status_code == 415
        assert answer.json()["type"] == "/problems/unsupported-media-type"


def test_large_bodies_are_refused_before_they_are_read(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    announced = http.post("/v1/meshes", content=b" " * 2_000_001, headers=headers)
    streamed = http.post("/v1/meshes", content=(b" " * 100_000 for _ in range(30)), headers=headers)
    for answer in (announced, streamed):
        assert answer.status_code == 413
        assert answer.json()["type"] == "/problems/body-too-large"


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="other"\r\n\r\n{}\r\n--b--\r\n',
        b'--b\r\nContent-Disposition: form-data; name="samples"; filename="a.npz"\r\n\r\n{}\r\n--b--\r\n',
        b"--b\r\nContent-Disposition: form-data\r\n\r\n{}\r\n--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n{}',
        (b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n{}\r\n' * 2) + b"--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n\xff\xfe\r\n--b--\r\n',
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n' + b"\r\n" * 50_000 + b"--b--\r\n",
    ],
)
def test_broken_multipart_is_a_400(http: httpx.Client, body: bytes) -> None:
    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    answer = http.post("/v1/meshes", content=body, headers=headers)
    assert answer.status_code == 400, answer.text
    assert http.post("/v1/meshes", content=body, headers={"Content-Type": "multipart/form-data"}).status_code == 400
