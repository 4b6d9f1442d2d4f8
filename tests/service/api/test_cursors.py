"""Cursors of lists."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import pytest

from equimesh_service.api.routing import cursor_of, position_of
from equimesh_service.problems.problem import Problem
from service.conftest import small
from service.guarded import Guarded


def test_the_list_does_not_tell_how_many_meshes_others_make(guarded_service: Guarded) -> None:
    with guarded_service.client("write") as own, guarded_service.client("admin") as admin:
        made = [own.post("/v1/meshes", json=small(label=f"{k}")).json()["id"] for k in range(3)][::-1]
        first = own.get("/v1/meshes?limit=1").json()["next_cursor"]
        moment = guarded_service.store.meshes.get(made[0])
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


def test_a_cursor_leads_back_to_its_row() -> None:
    row: Any = SimpleNamespace(id="m-1", number=258, created_at=1234.5)
    assert position_of(cursor_of(row, None), None) == (258,)
    assert position_of(cursor_of(row, "k"), "k") == (1234.5, "m-1")


@pytest.mark.parametrize(
    ("cursor", "key_id"),
    [
        *((cursor, None) for cursor in ("", "0", "g", "F", "-1", "f" * 16, "1" * 17, "1 ")),
        *(
            (cursor, "k")
            for cursor in ("", "102", "0" * 16, "0" * 15 + "gm-1", "0" * 16 + "m 1", "7ff0" + "0" * 12 + "m-1")
        ),
    ],
)
def test_what_is_no_cursor_is_refused(cursor: str, key_id: str | None) -> None:
    with pytest.raises(Problem) as caught:
        position_of(cursor, key_id)
    (complaint,) = caught.value.errors
    assert (complaint.parameter, complaint.message) == ("cursor", "not a cursor of this list")
