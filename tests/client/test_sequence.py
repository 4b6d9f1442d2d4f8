"""Sequences on a real service: steps, what is raised, and answers that get lost. Many tests run with both clients."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh_client import (
    BadArgument,
    Client,
    Conflict,
    Curvature,
    Field,
    Intersection,
    InvalidInput,
    NodalSolution,
    NotFound,
    Weight,
)
from equimesh_client.wire.transport import BlockingTransport, Session
from service.conftest import settings, until, url

__all__ = ["settings", "url"]


def front(x: Any, y: Any, moved: float) -> Any:
    return np.tanh(15.0 * (x + y / 2 - 0.6 - moved))


@pytest.mark.parametrize("connect", ["async"], indirect=True)
def test_a_sequence_steps_and_ends(connect: Any, url: str) -> None:
    client = connect(url, timeout=300.0)
    sequence = client.sequences.start("tanh(15*(x + y/2 - 0.6))", (13, 17), keep=3)
    before = sequence.x
    one = sequence.step(lambda x, y: front(x, y, 0.05), {"p": sequence.x - sequence.y})
    assert (one.number, one.u.shape, sequence.current) == (1, (13, 17), one)
    assert np.abs(one.fields["p"] - (one.x - one.y)).max() < 1e-12
    assert np.abs(one.x - before).max() > 0.005
    two = sequence.step("tanh(15*(x + y/2 - 0.6 - t))", t=0.1)
    assert (two.number, dict(two.fields)) == (2, {})
    assert np.abs(two.u - front(two.x, two.y, 0.1)).max() < 1e-12
    other = client.sequences.get(sequence.id)
    np.testing.assert_array_equal(other.x, two.x)
    other.step(front(other.x, other.y, 0.11))
    with pytest.raises(Conflict, match="at step 3, not 2"):
        sequence.step(front(sequence.x, sequence.y, 0.12))
    with pytest.raises(InvalidInput, match="transpose"):
        other.step(other.x.T)
    with pytest.raises(BadArgument, match="belong to an expression"):
        other.step(other.x, t=1.0)
    assert other.mesh().quality.q_eq.max > 1.0
    other.delete()
    with pytest.raises(NotFound):
        client.sequences.get(sequence.id)


def test_a_step_says_all_after_one_round_trip(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with Client(url) as client:
        sequence = client.sequences.start("tanh(15*(x + y/2 - 0.6))", (13, 17))
        assert (sequence.current.status, sequence.current.velocity) == ("succeeded", None)
        send, calls = BlockingTransport.send, []

        async def count(transport: BlockingTransport, step: Any) -> Any:
            calls.append(step.call.path)
            return await send(transport, step)

        monkeypatch.setattr(BlockingTransport, "send", count)

        def next_step() -> bool:
            """Whether the step took one round trip: a busy service first answers that the step is accepted."""
            nonlocal x, y
            x, y = sequence.x, sequence.y
            cells = (x[1:, 1:] + x[:-1, :-1]) / 2
            calls.clear()
            sequence.step(front(x, y, 0.05), {"v": np.dstack([x, -y]), "rho": Field(cells, "conservative", "cells")})
            return len(calls) == 1

        x, y = sequence.x, sequence.y
        until(next_step)
        one = sequence.current
        assert one.velocity is not None
        np.testing.assert_array_equal(one.velocity, np.dstack([one.x - x, one.y - y]))
        assert (one.status, one.warnings) == ("succeeded", one.certificate.warnings)
        assert one.certificate.record == sequence.mesh().certificate.record  # type: ignore[union-attr]
        assert {name: values.shape for name, values in one.fields.items()} == {"v": (13, 17, 2), "rho": (12, 16)}
        assert np.abs(one.fields["v"] - np.dstack([one.x, -one.y])).max() < 1e-12
        again = client.sequences.get(sequence.id).current
        assert again.certificate.record == one.certificate.record
        np.testing.assert_array_equal(again.velocity, one.velocity)  # type: ignore[arg-type]


def test_the_last_good_mesh_stays_after_bad_input(url: str) -> None:
    with Client(url) as client:
        sequence = client.sequences.start("tanh(15*(x - 0.5))", 9)
        bad = sequence.x.copy()
        bad[3, 4] = np.nan
        for u, fields, words in (
            (bad, None, r"u\[3\]\[4\] is NaN .* a solver that diverged"),
            (sequence.x[1:], None, "shape"),
            (
                sequence.x[1:, 1:],
                None,
                "u has one value for each of the cells, and a monitor needs one for each of the nodes",
            ),
            (sequence.x, {"rho": sequence.x[1:, 1:]}, "rho has one value for each of the cells"),
            (sequence.x, {"p": bad}, r"p\[3\]\[4\] is NaN"),
        ):
            with pytest.raises(InvalidInput, match=words):
                sequence.step(u, fields)
        assert sequence.current.number == client.sequences.get(sequence.id).current.number == 0
        assert sequence.step(sequence.x).number == 1


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_settings_change_midway_and_sequences_are_listed(connect: Any, url: str) -> None:
    client = connect(url, timeout=300.0)
    sequence = client.sequences.start(monitor=Weight(rho="1 + x"), n=9)
    with pytest.raises(BadArgument, match="has no u"):
        sequence.current.u  # noqa: B018
    x, y = sequence.x, sequence.y
    both = Intersection([Curvature(u={"field": "a"}, smoothing=0.05), Weight(rho=lambda x, y: 1 + y + 0 * x)])
    step = sequence.step(fields={"a": front(x, y, 0.0)}, monitor=both)
    assert [*step.fields] == ["a"]
    step = sequence.step(step.fields["a"], monitor=Curvature(norm="h1", smoothing=0.1))
    spec = sequence.mesh().spec()["monitor"]
    assert (spec["kind"], spec["norm"], spec["smoothing"]) == ("curvature", "h1", 0.1)
    other = client.sequences.start("x*y", 9)
    listed = list(client.sequences.list(limit=2))
    assert [(record.id, record.number) for record in listed] == [(other.id, 0), (sequence.id, 2)]
    assert listed[1].certificate is not None
    assert listed[1].mesh_id == step.mesh_id


def test_a_step_whose_answer_got_lost_is_taken_once(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with Client(url) as client:
        sequence = client.sequences.start("tanh(15*(x - 0.5))", 9)
        u, run = front(sequence.x, sequence.y, 0.0), Session.run

        async def lose(session: Session, flow: Any, report: Any = None) -> Any:
            await run(session, flow, report)
            raise KeyboardInterrupt

        with monkeypatch.context() as patched:
            patched.setattr(Session, "run", lose)
            with pytest.raises(KeyboardInterrupt):
                sequence.step(u)
        assert sequence.current.number == 0
        assert sequence.step(u).number == 1


CORNER: dict[str, Any] = {
    "kind": "blocks",
    "vertices": {
        "a": [0, 0],
        "b": [1, 0],
        "c": [1, 1],
        "d": [0, 1],
        "e": [2, 0],
        "f": [2, 1],
        "g": [1, 2],
        "h": [0, 2],
    },
    "blocks": [
        {"corners": ["a", "b", "c", "d"], "cells": [6, 6]},
        {"corners": ["b", "e", "f", "c"], "cells": [6, 6]},
        {"corners": ["d", "c", "g", "h"], "cells": [6, 6]},
    ],
}


def wave(x: Any, y: Any, moved: float = 0.0) -> Any:
    return np.tanh(6.0 * (x + y / 2 - 0.8 - moved))


def test_a_sequence_on_blocks_carries_fields_and_goes_on(url: str) -> None:
    with Client(url) as client:
        sequence = client.sequences.start("tanh(6*(x + y/2 - 0.8))", domain=CORNER)
        count = len(sequence.x)
        assert sequence.x.shape == (count,)
        fields = {
            "p": 1.0 + sequence.x,
            "v": np.stack([sequence.x, sequence.y], axis=1),
            "mass": Field(np.ones(108), "conservative", "cells"),
        }
        one = sequence.step(lambda x, y: wave(x, y, 0.05), fields)
        assert (one.number, one.u.shape, one.substeps) == (1, (count,), 1)
        assert one.moved > 0.0
        np.testing.assert_allclose(one.fields["p"], 1.0 + one.x, atol=1e-12)
        np.testing.assert_allclose(one.fields["v"], np.stack([one.x, one.y], axis=1), atol=1e-12)
        np.testing.assert_allclose(one.fields["mass"], 1.0, atol=1e-12)
        assert one.velocity is not None
        np.testing.assert_allclose(one.velocity, one.fields["v"] - fields["v"], atol=1e-12)
        two = sequence.step("tanh(6*(x + y/2 - 0.8 - t))", {"p": one.fields["p"]}, t=0.1)
        np.testing.assert_allclose(two.u, wave(two.x, two.y, 0.1), atol=1e-12)
        np.testing.assert_allclose(two.fields["p"], 1.0 + two.x, atol=1e-12)
        with pytest.raises(InvalidInput, match=f"{count} nodes"):
            sequence.step(np.ones(count + 1))
        assert sequence.mesh().quality.min_jacobian > 0.0
        sequence.delete()


def test_values_at_the_nodes_of_other_blocks_are_refused(url: str) -> None:
    mesh = em.Blocks.of(CORNER).mesh
    u = {"nodes": mesh.points, "values": wave(mesh.x, mesh.y)}
    with Client(url) as client:
        for more, found in (
            ({"domain": {**CORNER, "refine": 2}}, "nodes"),
            ({}, "mesh of blocks"),
            ({"domain": CORNER, "u": {**u, "nodes": mesh.points * 0.5}}, "another domain"),
        ):
            given = {"u": u, "monitor": NodalSolution(), **more}
            with pytest.raises(InvalidInput, match=found):
                client.generate(**given)  # type: ignore[arg-type]
