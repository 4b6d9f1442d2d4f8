"""API keys: who is let in, what each may do, and that nobody sees what is another's."""

from __future__ import annotations

import json
import re
import sqlite3
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from equimesh_cli import main
from equimesh_service import Settings, running
from equimesh_service.admission.callers import ANYONE, Callers
from equimesh_service.api.app import create_app
from equimesh_service.problems.problem import Problem
from equimesh_service.store.key_secrets import KeyRow
from equimesh_service.store.keys import KeyStore
from equimesh_service.store.store import Store
from equimesh_service.upkeep.exposure import ExposedError, check_exposure, is_loopback
from service.conftest import small
from service.guarded import Guarded

GRID = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 5]]}}
# What needs no key.
OPEN = {"/livez", "/readyz", "/problems/{name}", "/v1/capabilities"}
BODIES: dict[str, Any] = {
    "/v1/meshes": small(),
    "/v1/sequences": small(),
    "/v1/samples": GRID,
    "/v1/expressions/check": {"expression": "x"},
}


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The description of the interface."""
    return create_app(Settings(data_dir=tmp_path_factory.mktemp("none"))).openapi()


@pytest.fixture(scope="module")
def owner(guarded_service: Guarded) -> Iterator[httpx.Client]:
    """Whoever has the mesh and the samples of this module."""
    with guarded_service.client("write") as client:
        yield client


@pytest.fixture(scope="module")
def mesh(owner: httpx.Client) -> str:
    """A finished mesh from samples of the owner."""
    spec = small(monitor={"u": {"samples": owner.post("/v1/samples", json=GRID).json()["id"]}}, label="owned")
    made = owner.post("/v1/meshes", json=spec, headers={"Prefer": "wait=30", "Idempotency-Key": "mine"})
    assert made.json()["status"] == "succeeded", made.text
    return str(made.json()["id"])


@pytest.fixture(scope="module")
def samples(owner: httpx.Client) -> str:
    """The samples of the owner."""
    return str(owner.post("/v1/samples", json=GRID).json()["id"])


@pytest.fixture(scope="module")
def sequence(owner: httpx.Client) -> str:
    """A sequence of the owner."""
    made = owner.post("/v1/sequences", json=small(label="moving"), headers={"Prefer": "wait=30"})
    assert made.json()["mesh"]["status"] == "succeeded", made.text
    return str(made.json()["id"])


def operations(document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    return [(m.upper(), path, op) for path, methods in document["paths"].items() for m, op in methods.items()]


def ask(client: httpx.Client, method: str, path: str) -> httpx.Response:
    return client.request(method, path.replace("{name}", "folded"), json=BODIES.get(path) if method == "POST" else None)


# Who is let in -----------------------------------------------------------------------------------------------


def test_every_path_but_the_open_ones_asks_for_a_key(guarded_service: Guarded, document: dict[str, Any]) -> None:
    with guarded_service.client() as nobody:
        for method, path, operation in operations(document):
            answer = ask(nobody, method, path)
            told = {"401", "403"} <= set(operation["responses"]) and "security" in operation
            if path in OPEN:
                assert answer.status_code == 200, (method, path)
                assert "security" not in operation, (method, path)
                continue
            assert answer.status_code == 401, (method, path)
            assert answer.headers["www-authenticate"] == "Bearer"
            assert told, (method, path)
            if method != "HEAD":
                assert answer.json()["type"] == "/problems/unauthorized"
        for page in ("/", "/docs", "/docs/assets/docs.js", "/openapi.json"):
            assert nobody.get(page).status_code == 200
    assert document["components"]["securitySchemes"]["ApiKey"]["scheme"] == "bearer"


@pytest.mark.parametrize(
    "header",
    ["Bearer", "Bearer x", "Basic em", "em_{id}_{rest}", "Bearer em_{id}_{other}", "Bearer em_{id}_{rest}x",
     "Bearer em_000000000000_{rest}", "Bearer em_{id}_", "Bearer {rest}", "Bearer ' OR 1=1 --", "Bearer \xe9"],
)  # fmt: skip
def test_a_bad_key_is_refused(guarded_service: Guarded, header: str) -> None:
    row, secret = guarded_service.key("admin")
    rest = secret.removeprefix(f"em_{row.id}_")
    sent = header.format(id=row.id, rest=rest, other=rest[::-1])
    answer = httpx.get(f"{guarded_service.url}/v1/meshes", headers={"Authorization": sent.encode("latin-1")})
    assert answer.status_code == 401, sent
    assert rest not in answer.text


def test_scopes_allow_what_they_say(guarded_service: Guarded, document: dict[str, Any]) -> None:
    def forbidden(client: httpx.Client) -> set[str]:
        answers = {f"{method} {path}": ask(client, method, path) for method, path, _ in operations(document)}
        assert not any(answer.status_code == 401 for answer in answers.values())
        return {name for name, answer in answers.items() if answer.status_code == 403}

    writing = {f"{m} {p}" for m, p, _ in operations(document) if m in ("POST", "DELETE") and "expressions" not in p}
    with guarded_service.client("read") as reader, guarded_service.client("write") as writer:
        assert forbidden(reader) == {*writing, "GET /metrics"}
        assert forbidden(writer) == {"GET /metrics"}
        refused = reader.post("/v1/meshes", json=small()).json()
        assert (refused["type"], refused["status"]) == ("/problems/forbidden", 403)
        assert "write" in refused["detail"]
    with guarded_service.client("admin") as admin:
        assert forbidden(admin) == set()
        assert admin.get("/metrics").status_code == 200


def test_the_list_does_not_tell_how_many_meshes_others_make(guarded_service: Guarded) -> None:
    with guarded_service.client("write") as own, guarded_service.client("admin") as admin:
        made = [own.post("/v1/meshes", json=small(label=f"{k}")).json()["id"] for k in range(3)][::-1]
        first = own.get("/v1/meshes?limit=1").json()["next_cursor"]
        moment = guarded_service.store.meshes.get(made[0])
        assert moment is not None
        assert first == struct.pack(">d", moment.created_at).hex() + made[0]  # which the key knows
        assert own.delete(f"/v1/meshes/{made[0]}").status_code == 204
        pages = [own.get("/v1/meshes", params={"limit": 1, "cursor": first})]
        while "next" in pages[-1].links:
            pages.append(own.get(pages[-1].links["next"]["url"]))
        assert [page.json()["items"][0]["id"] for page in pages] == made[1:]
        another = admin.get("/v1/meshes?limit=1").json()["next_cursor"]
        for client, cursor in (
            (own, another),
            (admin, first),
            (own, "7ff0000000000000m-1"),  # infinity
            (own, f"{first}\x00"),
            (own, first[:16]),
        ):
            refused = client.get("/v1/meshes", params={"cursor": cursor})
            assert (refused.status_code, refused.json()["errors"][0]["parameter"]) == (422, "cursor")


def test_a_revoked_key_stops_working_within_two_seconds(guarded_service: Guarded) -> None:
    row, secret = guarded_service.key("read")
    with guarded_service.having(secret) as client:
        assert client.get("/v1/meshes").status_code == 200
        assert guarded_service.store.keys.revoke(row.id)
        revoked = time.monotonic()
        while client.get("/v1/meshes").status_code != 401:
            assert time.monotonic() - revoked < 2.0
            time.sleep(0.05)
        assert client.get("/v1/meshes").status_code == 401
    assert not guarded_service.store.keys.revoke(row.id)


class Counted(KeyStore):
    """A store of one key that counts how often it is asked."""

    def __init__(self, row: KeyRow | None) -> None:
        self.row, self.asked = row, 0

    def get(self, key_id: str) -> KeyRow | None:
        self.asked += 1
        return self.row if self.row is not None and key_id == self.row.id else None

    def exist(self) -> bool:
        self.asked += 1
        return self.row is not None


@pytest.mark.anyio
async def test_a_warm_key_costs_no_look_at_the_store(guarded_service: Guarded) -> None:
    row, secret = guarded_service.key("write")
    now = [0.0]
    store = Counted(row)
    callers = Callers(store, clock=lambda: now[0])
    first = await callers.identify(secret)
    assert (first.key_id, first.scopes, first.admin) == (row.id, {"read", "write"}, False)
    assert [await callers.identify(secret) for _ in range(50)] == [first] * 50
    assert store.asked == 1
    now[0] = 1.9
    await callers.identify(secret)
    assert store.asked == 2
    assert secret not in repr(vars(callers))


@pytest.mark.anyio
async def test_keys_are_asked_for_from_the_first_one_on() -> None:
    now = [0.0]
    store = Counted(None)
    callers = Callers(store, clock=lambda: now[0])
    assert [await callers.identify(None) for _ in range(9)] == [ANYONE] * 9
    assert store.asked == 1
    store.row = KeyRow(id="0" * 12, name="first", sha256="", scopes=("read",), created_at=0.0, revoked_at=0.5)
    now[0] = 1.9
    with pytest.raises(Problem, match="unauthorized"):
        await callers.identify(None)
    assert not await callers.stands(ANYONE)


# What is whose -----------------------------------------------------------------------------------------------


def test_nothing_of_another_key_is_there(
    guarded_service: Guarded,
    owner: httpx.Client,
    mesh: str,
    samples: str,
    sequence: str,
    document: dict[str, Any],
) -> None:
    ids = {"/v1/meshes/{id}": mesh, "/v1/samples/{id}": samples, "/v1/sequences/{id}": sequence}
    walked = 0
    with guarded_service.client("write") as other:
        for method, path, _ in operations(document):
            if "{id}" not in path:
                continue
            whose = [known for known in ids if path.startswith(known)]
            assert whose, f"{path} has an id: say here of what, and see that it is not there for others"
            mine = other.request(method, path.replace("{id}", ids[whose[0]]))
            none = other.request(method, path.replace("{id}", "m-0"))
            assert mine.status_code == 404, (method, path, mine.text)
            assert mine.content == none.content, (method, path)  # not even that there is something
            walked += 1
        assert walked >= 15
        refused = other.post("/v1/meshes", json=small(monitor={"u": {"samples": samples}}))
        assert refused.json()["errors"][0]["pointer"] == "/monitor/u/samples"
        assert other.get("/v1/meshes").json()["items"] == []
        assert other.get("/v1/meshes?label=owned").json()["items"] == []
    assert owner.get(f"/v1/meshes/{mesh}").json()["status"] == "succeeded"
    assert owner.get(f"/v1/samples/{samples}?format=npz").status_code == 200
    assert owner.get(f"/v1/sequences/{sequence}").json()["step"] == 0
    assert [item["id"] for item in owner.get("/v1/meshes?label=owned").json()["items"]] == [mesh]


def test_an_admin_sees_all(
    guarded_service: Guarded, mesh: str, samples: str, sequence: str, document: dict[str, Any]
) -> None:
    with guarded_service.client("admin") as admin:
        for method, path, _ in operations(document):
            if "{id}" in path and method == "GET":
                mine = sequence if "sequences" in path else samples if "samples" in path else mesh
                known = path.replace("{id}", mine)
                headers = {"Accept": "application/json"} if "events" in path else {}
                assert admin.get(known, headers=headers).status_code == 200, known
        assert mesh in [item["id"] for item in admin.get("/v1/meshes?limit=200").json()["items"]]


def test_not_even_an_admin_takes_the_steps_of_others(guarded_service: Guarded, sequence: str) -> None:
    with guarded_service.client("admin") as admin:
        step = {"step": 0, "u": {"expression": "x"}}
        assert admin.post(f"/v1/sequences/{sequence}/steps", json=step).status_code == 403


def test_idempotency_keys_are_each_key_s_own(guarded_service: Guarded, owner: httpx.Client, mesh: str) -> None:
    with guarded_service.client("write") as other:
        asked = {"json": small(label="owned"), "headers": {"Idempotency-Key": "mine", "Prefer": "wait=30"}}
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
                revoked = time.monotonic()
                for line in lines:
                    assert line != "event: done"
                    assert time.monotonic() - revoked < 3.0
        finally:
            admin.delete(place)


# How a service begins ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("host", "inside"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),
     ("10.0.0.7", False), ("", False), ("service.example", False), ("localhost.example", False)],
)  # fmt: skip
def test_which_addresses_only_this_machine_reaches(host: str, inside: bool) -> None:
    assert is_loopback(host) is inside


def test_others_are_not_served_without_a_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    public = ["serve", "--host", "0.0.0.0", "--port", "0", "--data-dir", str(tmp_path)]
    assert main(public) == 2
    told = capsys.readouterr().err
    assert f"`equimesh keys create --name NAME --scope write --data-dir {tmp_path}`" in told
    assert "--allow-anonymous true" in told
    settings = Settings(data_dir=tmp_path, host="0.0.0.0")
    with pytest.raises(ExposedError), running(settings):
        pass
    check_exposure(settings.model_copy(update={"allow_anonymous": True}))
    store = Store(settings.database)
    row, _ = store.keys.create("only", ["admin"])
    store.keys.revoke(row.id)  # it closed the service, and its end does not open it
    store.close()
    check_exposure(settings)


# The command -------------------------------------------------------------------------------------------------


def test_the_command_makes_lists_and_revokes_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = ["--data-dir", str(tmp_path / "new")]
    assert main(["keys", "list", *folder]) == 2  # a slip in the folder's name makes no database
    assert main(["keys", "create", "--name", "ada", "--scope", "write", "--scope", "read", *folder]) == 0
    secret = capsys.readouterr().out.split()[0]
    assert re.fullmatch(r"em_[0-9a-f]{12}_[A-Za-z0-9_-]{43}", secret)
    assert main(["keys", "create", "--name", "bob", "--json", *folder]) == 0
    made = json.loads(capsys.readouterr().out)
    assert main(["keys", "list", "--json", *folder]) == 0
    out = capsys.readouterr().out
    assert [(key["name"], key["scopes"], key["revoked_at"]) for key in json.loads(out)] == [
        ("ada", ["read", "write"], None),
        ("bob", ["write"], None),
    ]
    assert main(["keys", "revoke", made["id"], *folder]) == 0
    assert main(["keys", "revoke", made["id"], *folder]) == 2
    assert main(["keys", "revoke", "none", *folder]) == 2
    assert main(["keys", "list", *folder]) == 0
    out += "".join(capsys.readouterr())
    assert all(word in out for word in ("ada", "bob", made["id"]))
    assert secret[-43:] not in out
    assert made["secret"][-43:] not in out


def test_the_secret_is_not_on_disk(tmp_path: Path) -> None:
    store = Store(Settings(data_dir=tmp_path).database)
    store.prepare()
    row, secret = store.keys.create("ada", ["read"])
    store.close()
    sqlite3.connect(tmp_path / "equimesh.sqlite3").execute("PRAGMA wal_checkpoint").close()
    assert all(secret[-43:].encode() not in file.read_bytes() for file in tmp_path.iterdir())
    assert re.fullmatch(r"[0-9a-f]{64}", row.sha256)


def test_a_scope_must_exist(tmp_path: Path) -> None:
    store = Store(Settings(data_dir=tmp_path).database)
    store.prepare()
    for scopes in ((), ("root",)):
        with pytest.raises(ValueError, match="scopes are read, write, admin"):
            store.keys.create("x", scopes)
    store.close()
