"""Sequences through both clients, on a real service: steps, what is raised, and answers that get lost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from equimesh_client import (
    BadArgument,
    Client,
    Conflict,
    Curvature,
    Field,
    Intersection,
    InvalidInput,
    NotFound,
    Weight,
)
from equimesh_client.wire.session import Session
from equimesh_client.wire.transport import SyncTransport
from equimesh_service import Settings, running


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("sequences")
    with running(Settings(port=0, workers=1, data_dir=folder, log_level="warning")) as address:
        yield address


def front(x: Any, y: Any, moved: float) -> Any:
    return np.tanh(15.0 * (x + y / 2 - 0.6 - moved))


def test_a_sequence_steps_and_ends(url: str) -> None:
    with Client(url) as client:
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
        x, y, calls = sequence.x, sequence.y, []
        send = SyncTransport.send

        def count(transport: SyncTransport, step: Any) -> Any:
            calls.append(step.call.path)
            return send(transport, step)

        monkeypatch.setattr(SyncTransport, "send", count)
        cells = (x[1:, 1:] + x[:-1, :-1]) / 2
        rho = Field(cells, "conservative", "cells")
        one = sequence.step(front(x, y, 0.05), {"v": np.dstack([x, -y]), "rho": rho})
        assert len(calls) == 1
        assert one.velocity is not None
        np.testing.assert_array_equal(one.velocity, np.dstack([one.x - x, one.y - y]))
        assert one.certificate is not None
        assert (one.status, one.warnings) == ("succeeded", one.certificate.warnings)
        assert one.certificate.record == sequence.mesh().certificate.record  # type: ignore[union-attr]
        assert {name: values.shape for name, values in one.fields.items()} == {"v": (13, 17, 2), "rho": (12, 16)}
        assert np.abs(one.fields["v"] - np.dstack([one.x, -one.y])).max() < 1e-12
        again = client.sequences.get(sequence.id).current
        assert again.certificate is not None
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
            (sequence.x[1:, 1:], None, "a monitor needs its values at the 9 x 9 nodes"),
            (sequence.x, {"rho": sequence.x[1:, 1:]}, "rho has one value for each of the cells"),
            (sequence.x, {"p": bad}, r"p\[3\]\[4\] is NaN"),
        ):
            with pytest.raises(InvalidInput, match=words):
                sequence.step(u, fields)
        assert sequence.current.number == client.sequences.get(sequence.id).current.number == 0
        assert sequence.step(sequence.x).number == 1


def test_settings_change_midway_and_sequences_are_listed(url: str) -> None:
    with Client(url) as client:
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

        def lose(session: Session, flow: Any, report: Any = None) -> Any:
            run(session, flow, report)
            raise KeyboardInterrupt

        with monkeypatch.context() as patched:
            patched.setattr(Session, "run", lose)
            with pytest.raises(KeyboardInterrupt):
                sequence.step(u)
        assert sequence.current.number == 0
        assert sequence.step(u).number == 1
