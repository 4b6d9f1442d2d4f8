"""Callers: who is allowed in, and with which scopes."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from equimesh_service.admission.callers import ANYONE, Callers
from equimesh_service.problems.problem import Problem
from equimesh_service.store.keys import KeyRow, KeyStore
from service.conftest import small, until
from service.guarded import Guarded
from service.interface import operations
from service.requests import GRID

# Routes that need no key.
OPEN = {"/livez", "/readyz", "/problems/{name}", "/v1/capabilities"}
BODIES: dict[str, Any] = {
    "/v1/meshes": small(),
    "/v1/sequences": small(),
    "/v1/samples": GRID,
    "/v1/expressions/check": {"expression": "x"},
}


def ask(client: httpx.Client, method: str, path: str) -> httpx.Response:
    return client.request(method, path.replace("{name}", "folded"), json=BODIES.get(path) if method == "POST" else None)


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


def test_a_revoked_key_soon_stops_working(guarded_service: Guarded) -> None:
    row, secret = guarded_service.key("read")
    with guarded_service.having(secret) as client:
        assert client.get("/v1/meshes").status_code == 200
        assert guarded_service.store.keys.revoke(row.id)
        until(lambda: client.get("/v1/meshes").status_code == 401)
        assert client.get("/v1/meshes").status_code == 401
    assert not guarded_service.store.keys.revoke(row.id)


class Counted(KeyStore):
    """A store of one key that counts its queries."""

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
    assert not await callers.is_valid(ANYONE)
