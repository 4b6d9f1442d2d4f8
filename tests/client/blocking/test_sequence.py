"""Sequences through both clients, on a real service: steps, what is raised, and answers that get lost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from equimesh_client import BadArgument, Client, Conflict, InvalidInput, NotFound
from equimesh_client.wire.session import Session
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
