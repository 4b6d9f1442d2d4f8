"""Meshes, samples and sequences of one key do not exist for another."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from service.conftest import small
from service.guarded import Guarded
from service.interface import operations
from service.parts import store_in_parts
from service.requests import GRID


@pytest.fixture(scope="module")
def key(guarded_service: Guarded) -> tuple[str, str]:
    """The id and the secret of the key of the owner."""
    row, secret = guarded_service.key("write")
    return row.id, secret


@pytest.fixture(scope="module")
def owner(guarded_service: Guarded, key: tuple[str, str]) -> Iterator[httpx.Client]:
    """The owner of the meshes and the samples of this module."""
    with guarded_service.having(key[1]) as client:
        yield client


@pytest.fixture(scope="module")
def parted(guarded_service: Guarded, key: tuple[str, str]) -> str:
    """A mesh in parts of the owner."""
    return store_in_parts(guarded_service.settings, key[0])


@pytest.fixture(scope="module")
def mesh(owner: httpx.Client) -> str:
    """A finished mesh from samples of the owner."""
    spec = small(
        monitor={"kind": "arc_length", "u": {"samples": owner.post("/v1/samples", json=GRID).json()["id"]}},
        label="owned",
    )
    made = owner.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300", "Idempotency-Key": "mine"})
    assert made.json()["status"] == "succeeded", made.text
    return str(made.json()["id"])


@pytest.fixture(scope="module")
def samples(owner: httpx.Client) -> str:
    """The samples of the owner."""
    return str(owner.post("/v1/samples", json=GRID).json()["id"])


@pytest.fixture(scope="module")
def sequence(owner: httpx.Client) -> str:
    """A sequence of the owner."""
    made = owner.post("/v1/sequences", json=small(label="moving"), headers={"Prefer": "wait=300"})
    assert made.json()["mesh"]["status"] == "succeeded", made.text
    return str(made.json()["id"])


def test_nothing_of_another_key_is_there(
    guarded_service: Guarded,
    owner: httpx.Client,
    mesh: str,
    parted: str,
    samples: str,
    sequence: str,
    document: dict[str, Any],
) -> None:
    ids = {
        "/v1/meshes/{id}/parts": parted,
        "/v1/meshes/{id}": mesh,
        "/v1/samples/{id}": samples,
        "/v1/sequences/{id}": sequence,
    }
    walked = 0
    with guarded_service.client("write") as other:
        for method, path, _ in operations(document):
            if "{id}" not in path:
                continue
            whose = [known for known in ids if path.startswith(known)]
            assert whose, f"{path} has an id: say here of what, and see that it is not there for others"
            here = path.replace("{number}", "0")
            mine = other.request(method, here.replace("{id}", ids[whose[0]]))
            none = other.request(method, here.replace("{id}", "m-0"))
            assert mine.status_code == 404, (method, path, mine.text)
            assert mine.content == none.content, (method, path)  # not even that there is something
            walked += 1
        assert walked >= 15
        refused = other.post("/v1/meshes", json=small(monitor={"kind": "arc_length", "u": {"samples": samples}}))
        assert refused.json()["errors"][0]["pointer"] == "/monitor/u/samples"
        assert other.get("/v1/meshes").json()["items"] == []
        assert other.get("/v1/meshes?label=owned").json()["items"] == []
        assert other.get("/v1/sequences").json()["items"] == []
    assert owner.get(f"/v1/meshes/{mesh}").json()["status"] == "succeeded"
    assert owner.get(f"/v1/meshes/{parted}/parts/0").status_code == 200
    assert owner.get(f"/v1/samples/{samples}?format=npz").status_code == 200
    assert owner.get(f"/v1/sequences/{sequence}").json()["step"] == 0
    assert [item["id"] for item in owner.get("/v1/meshes?label=owned").json()["items"]] == [mesh]
    assert [item["id"] for item in owner.get("/v1/sequences").json()["items"]] == [sequence]


def test_an_admin_sees_all(
    guarded_service: Guarded, mesh: str, parted: str, samples: str, sequence: str, document: dict[str, Any]
) -> None:
    with guarded_service.client("admin") as admin:
        for method, path, _ in operations(document):
            if "{id}" in path and method == "GET":
                words = {"sequences": sequence, "samples": samples, "parts": parted}
                mine = next((words[word] for word in words if word in path), mesh)
                known = path.replace("{id}", mine).replace("{number}", "0")
                headers = {"Accept": "application/json"} if "events" in path else {}
                assert admin.get(known, headers=headers).status_code == 200, known
        assert mesh in [item["id"] for item in admin.get("/v1/meshes?limit=200").json()["items"]]
        assert sequence in [item["id"] for item in admin.get("/v1/sequences?limit=200").json()["items"]]


def test_not_even_an_admin_takes_the_steps_of_others(guarded_service: Guarded, sequence: str) -> None:
    with guarded_service.client("admin") as admin:
        step = {"step": 0, "u": {"expression": "x"}}
        assert admin.post(f"/v1/sequences/{sequence}/steps", json=step).status_code == 403


def test_idempotency_keys_are_each_key_s_own(guarded_service: Guarded, owner: httpx.Client, mesh: str) -> None:
    with guarded_service.client("write") as other:
        asked = {"json": small(label="owned"), "headers": {"Idempotency-Key": "mine", "Prefer": "wait=300"}}
        made = other.post("/v1/meshes", **asked)  # type: ignore[arg-type]
        assert made.status_code == 201
        assert made.json()["id"] != mesh
        assert other.post("/v1/meshes", **asked).json()["id"] == made.json()["id"]  # type: ignore[arg-type]
        assert owner.get(made.headers["location"]).status_code == 404


def test_the_same_samples_of_two_keys_are_each_one_s_own(guarded_service: Guarded) -> None:
    grid = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 7]]}}
    with guarded_service.client("write") as one, guarded_service.client("write") as two:
        first, second = one.post("/v1/samples", json=grid), two.post("/v1/samples", json=grid)
        assert (first.status_code, second.status_code) == (201, 201)  # that they were here is not told
        place = first.headers["location"]
        assert place == second.headers["location"]
        assert first.json()["created_at"] < second.json()["created_at"]
        assert one.delete(place).status_code == 204
        assert one.get(place).status_code == 404
        assert two.get(f"{place}?format=npz").status_code == 200
        assert two.delete(place).status_code == 204
        assert one.post("/v1/samples", json=grid).status_code == 201


def test_a_stream_ends_when_its_key_is_revoked(guarded_service: Guarded) -> None:
    row, secret = guarded_service.key("write")
    # More work than there is time for.
    spec = small(grid={"n_xi": 30, "n_eta": 30}, schwarz={"tolerance": None, "max_iterations": 1000})
    spec["schwarz"] |= {"subdomains": [4, 1], "transmission": {"kind": "linear_robin"}, "fallback": False}
    with guarded_service.having(secret) as client, guarded_service.client("admin") as admin:
        place = client.post("/v1/meshes", json=spec).headers["location"]
        try:
            with client.stream("GET", f"{place}/events") as stream:
                lines = stream.iter_lines()
                next(lines)
                guarded_service.store.keys.revoke(row.id)
                for line in lines:
                    assert line != "event: done"
        finally:
            admin.delete(place)
