"""Cursors of lists."""

from __future__ import annotations

import struct

from service.conftest import small
from service.guarded import Guarded


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
