"""Both clients against a service that misbehaves, the same tests; what only that for asyncio does is at the end."""

from __future__ import annotations

import asyncio
import io
from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_client import AsyncClient, BadArgument, InvalidInput, NotFound, Rectangle, SampleFile


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_reuse_can_be_declined(connect: Any, service: Any) -> None:
    client = connect(f"{service.url}/v1/")  # the address of its interface, too
    client.generate("x", 5)
    client.generate("x", 5, reuse=False)
    client.meshes.create(spec(), reuse=False)
    assert [r.query for r in service.seen("POST", "meshes$")] == [{}, {"reuse": "false"}, {"reuse": "false"}]


def test_a_mesh_that_is_not_kept_is_computed_in_one_request(connect: Any, service: Any) -> None:
    arrays = connect(service.url).compute("x", (5, 4))
    assert arrays.x.shape == (5, 4)
    assert arrays.certificate.status == "relaxed"
    (sent,) = service.requests
    assert (sent.method, sent.path, sent.query) == ("POST", "/v1/meshes", {"store": "false", "format": "npz"})
    assert not {"idempotency-key", "prefer"} & {name.lower() for name in sent.headers}
    assert service.meshes == {}
    with pytest.raises(TypeError, match="nonsense"):
        connect(service.url).compute("x", 5, nonsense=1)


def test_an_argument_of_another_call_is_refused_with_its_name_here(connect: Any, service: Any) -> None:
    with pytest.raises(TypeError, match=r"adapt\(\) has no argument 'max_points'; did you mean 'points'"):
        connect(service.url).adapt(len, max_points=100)


def test_two_creates_are_two_meshes(connect: Any, service: Any) -> None:
    client = connect(service.url)
    assert client.generate("x", 5).id != client.generate("x", 5).id


def test_big_samples_travel_as_npz_and_small_ones_inline(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate(np.ones((3, 3)), 5)
    assert service.seen("POST", "meshes")[-1].headers["content-type"] == "application/json"
    client.generate(lambda x, y: x + 2 * y, 5, n_samples=65)
    sent = service.seen("POST", "meshes")[-1]
    assert sent.headers["content-type"].startswith("multipart/form-data; boundary=")
    name, data = parts_of(sent)["samples"]
    assert name == "samples.npz"
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        x, y = np.meshgrid(file["x"], file["y"], indexing="ij")
        assert np.array_equal(file["values"], x + 2 * y)


def test_bad_input_is_shown_with_a_caret(connect: Any, service: Any) -> None:
    with pytest.raises(InvalidInput) as caught:
        connect(service.url).generate("1 + foo*x", 5)
    assert str(caught.value).splitlines() == [
        "Invalid input (HTTP 422)",
        "  /monitor/u/expression: unknown name 'foo'",
        "      1 + foo*x",
        "          ^",
    ]
    with pytest.raises(InvalidInput) as caught:
        connect(service.url).check("foo")
    assert str(caught.value).endswith("      foo\n      ^")


def test_listing_goes_over_pages(connect: Any, service: Any) -> None:
    client = connect(service.url)
    for _ in range(5):
        client.meshes.create(spec())
    assert [mesh.id for mesh in client.meshes.list()] == ["m4", "m3", "m2", "m1", "m0"]
    assert [mesh.id for mesh in client.meshes.list(limit=3)] == ["m4", "m3", "m2"]
    assert list(client.meshes.list(limit=0)) == []
    assert client.meshes.get("m2").id == "m2"
    with pytest.raises(NotFound):
        client.meshes.get("../v1/capabilities")


def test_samples_are_stored_and_used(connect: Any, service: Any, tmp_path: Any) -> None:
    client = connect(service.url)
    stored = client.samples.upload(np.ones((3, 3)))
    assert stored.record["shape"] == [3, 3]
    client.generate(stored, 5)
    assert client.meshes.get("m0").spec()["monitor"]["u"] == {"samples": stored.id}
    client.samples.delete(stored)
    with pytest.raises(NotFound):
        client.samples.delete(stored.id)
    (tmp_path / "u.csv").write_text("x,y,u\n0,0,1\n")
    stored = client.samples.upload(tmp_path / "u.csv")
    assert service.samples[stored.id] == b"x,y,u\n0,0,1\n"


def test_a_file_with_a_chosen_column_is_stored_first(connect: Any, service: Any, tmp_path: Any) -> None:
    client = connect(service.url)
    (tmp_path / "flow.csv").write_text("x,y,p,T\n0,0,1,2\n")
    file = SampleFile(tmp_path / "flow.csv", column="T")
    stored = client.samples.upload(file)
    assert service.seen("POST", "samples")[0].query == {"column": "T"}
    client.generate(file, 5)
    assert client.meshes.get("m0").spec()["monitor"]["u"] == {"samples": stored.id}
    assert [call.query for call in service.seen("POST", "samples")] == [{"column": "T"}] * 2
    client.samples.upload(tmp_path / "flow.csv")
    assert service.seen("POST", "samples")[2].query == {}
    with pytest.raises(BadArgument, match="is stored first"):
        client.meshes.create({**spec(), "monitor": {"u": {"samples": "upload"}}}, samples=file)


def test_samples_go_with_a_spec_that_wants_them(connect: Any, service: Any) -> None:
    client = connect(service.url)
    wanting = {**spec(), "monitor": {"u": {"samples": "upload"}}}
    client.meshes.create(wanting, samples=np.ones((3, 3)))
    with pytest.raises(BadArgument, match="samples go with"):
        client.meshes.create(wanting)
    with pytest.raises(BadArgument, match="samples go with"):
        client.meshes.create(spec(), samples=np.ones((3, 3)))


BIG = np.ones((60, 60))


def test_samples_are_stored_for_a_domain(connect: Any, service: Any) -> None:
    client = connect(service.url)
    first = client.samples.upload(BIG, domain=Rectangle(x=(0, 2)))
    assert first.id != client.samples.upload(BIG).id
    client.check("x", domain=Rectangle(x=(0, 2)))
    assert b'"x": [0.0, 2.0]' in service.seen("POST", "check")[-1].body


def test_a_canceled_task_cancels_its_mesh(service: Any) -> None:
    async def cancel() -> None:
        async with AsyncClient(service.url) as client:
            task = asyncio.create_task(client.generate("x", 5, label="hang"))
            while "m0" not in service.meshes:
                await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(asyncio.wait_for(cancel(), 30))
    assert service.meshes["m0"]["status"] == "canceled"


def test_meshes_are_made_at_the_same_time(service: Any) -> None:
    async def generate() -> set[str]:
        async with AsyncClient(service.url) as client:
            meshes = await asyncio.gather(*(client.generate("x", 5, label="slow") for _ in range(4)))
            return {mesh.id for mesh in meshes}

    assert len(asyncio.run(asyncio.wait_for(generate(), 30))) == 4
