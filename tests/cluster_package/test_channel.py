"""The channel between tasks on workers: order, copies, many and large messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from distributed import Client

from dask_processes import DaskProcesses
from equimesh.numerics.channel import PeerLostError
from equimesh_cluster import channel as module
from equimesh_cluster import run_parts


def program() -> Any:
    """A function that travels to processes which do not have this file, since it is local."""

    def everyone_to_everyone(channel: Any, size: int) -> list[float]:
        """What came from all other parts, in the order in which it is received: by sender and tag, last tag first."""
        others = [k for k in range(channel.count) if k != channel.number]
        for to in others:
            for k in range(5):
                channel.send(to, f"tag {k % 2}", [np.full(size, 10.0 * channel.number + k), np.empty((0, 3))])
        found = []
        for sender in others:
            for tag in ("tag 1", "tag 0"):
                for _ in range(3 if tag == "tag 0" else 2):
                    values, empty = channel.receive(sender, tag)
                    assert values.shape == (size,)
                    assert empty.shape == (0, 3)
                    found.append(float(values.sum()) / size)
        return found

    return everyone_to_everyone


@pytest.mark.parametrize("size", [1, 200_000])
def test_messages_of_a_sender_and_tag_keep_their_order_between_processes(processes: DaskProcesses, size: int) -> None:
    processes.have(2)
    run = run_parts(processes.client, program(), lambda _, __: (size,))
    for number, future in enumerate(run.futures):
        other = 10.0 * (1 - number)
        assert future.result() == [other + 1, other + 3, other, other + 2, other + 4]


def test_a_part_waits_for_those_that_begin_later(client: Client) -> None:
    """One worker is busy when its part is sent to it."""
    address = sorted(client.nthreads())[2]
    blocks = [client.submit(_sleep, k, workers=[address], pure=False, priority=20) for k in range(2)]
    run = run_parts(client, program(), lambda _, __: (3,))
    assert run.futures[0].result()[:5] == [11.0, 13.0, 10.0, 12.0, 14.0]
    client.gather(blocks)


def _sleep(_: int) -> None:
    import time

    time.sleep(0.5)


def test_a_part_that_never_begins_is_given_up(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def sending_to_itself_by_another_name(channel: Any) -> None:
        channel._seat = type(channel._seat)(
            run="nobody", number=0, addresses=channel._seat.addresses, identity="", key=""
        )
        channel.send(1, "a", [np.zeros(1)])
        channel.flush()

    monkeypatch.setattr(module, "MAX_START_SECONDS", 0.1)
    with pytest.raises(Exception, match=r"part 1 on .* cannot be reached .*did not begin within 0 s: .* is busy"):
        run_parts(client, sending_to_itself_by_another_name, lambda _, __: (), parts=2)


def test_a_part_that_does_not_exist_is_refused(client: Client) -> None:
    def wrong(channel: Any) -> None:
        channel.send(2, "a", [np.zeros(1)])

    with pytest.raises(ValueError, match="part 2 does not exist: there are 2"):
        run_parts(client, wrong, lambda _, __: (), parts=2)


def test_a_channel_of_a_run_that_has_ended_refuses_everything(client: Client) -> None:
    def ended(channel: Any) -> list[str]:
        channel._box.end(PeerLostError("over"))
        found = []
        for call in (channel.require_running, channel.flush, lambda: channel.receive(0, "a")):
            try:
                call()
            except PeerLostError as error:
                found.append(str(error))
        channel._box.ended = None
        return found

    assert run_parts(client, ended, lambda _, __: (), parts=1).futures[0].result() == ["over"] * 3
