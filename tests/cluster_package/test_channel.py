"""The channel between tasks on workers: order, copies, many and large messages."""

from __future__ import annotations

import pickle
import threading
from typing import Any

import numpy as np
import pytest
from distributed import Client

from dask_processes import DaskProcesses
from equimesh_cluster import channel as module
from equimesh_cluster import run_parts
from equimesh_cluster.channel import TOPIC, Box, Messages, Seat, listening, run_part
from equimesh_cluster.messages import PeerFailedError, PeerLostError
from equimesh_cluster.workers import examine_workers


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


# Boxes of messages, and the plugin that fills them.


def arrays(*values: float) -> list[Any]:
    return [np.array(values)]


class WorkerOfTasks:
    """As much of a worker as the plugin looks at."""

    def __init__(self, *keys: str) -> None:
        self.handlers: dict[str, Any] = {}
        self.state = type("State", (), {"tasks": {key: type("Task", (), {"state": "executing"})() for key in keys}})()


def test_a_box_keeps_the_order_of_each_sender_and_tag() -> None:
    box = Box("key")
    box.put(1, [("a", arrays(1.0)), ("b", arrays(2.0)), ("a", arrays(3.0))])
    box.put(2, [("a", arrays(4.0))])
    assert [box.take(1, "a")[0][0], box.take(2, "a")[0][0], box.take(1, "a")[0][0], box.take(1, "b")[0][0]] == [
        *(1.0, 4.0, 3.0, 2.0)
    ]


def test_who_waits_is_told_that_the_run_has_ended_and_by_what() -> None:
    box, seen = Box("key"), []

    def wait() -> None:
        try:
            box.take(0, "a")
        except PeerFailedError as error:
            seen.append(str(error))

    waiting = threading.Thread(target=wait)
    waiting.start()
    box.end(PeerFailedError("part 3 failed"))
    box.end(PeerLostError("later"))
    waiting.join(timeout=30)
    assert seen == ["part 3 failed"]
    box.put(0, [("a", arrays(1.0))])
    with pytest.raises(PeerFailedError):
        box.take(0, "a")


def test_messages_are_taken_for_parts_that_run_and_for_no_others() -> None:
    plugin, worker = Messages(), WorkerOfTasks("key")
    plugin.setup(worker)  # type: ignore[arg-type]
    assert not plugin.deliver("run", 0, 1, [("a", arrays(1.0))])
    box = plugin.open("run", 0, "key")
    assert plugin.deliver("run", 0, 1, [("a", arrays(1.0))])
    assert not plugin.deliver("other", 0, 1, [("a", arrays(1.0))])
    assert box.take(1, "a")[0][0] == 1.0
    plugin.close("run", 0)
    assert not plugin.deliver("run", 0, 1, [("a", arrays(1.0))])
    assert plugin.boxes == {}
    plugin.teardown(worker)  # type: ignore[arg-type]
    assert worker.handlers == {}


def test_the_end_of_a_run_reaches_its_parts_only() -> None:
    plugin = Messages()
    plugin.setup(WorkerOfTasks("a", "b", "c"))  # type: ignore[arg-type]
    boxes = [plugin.open("run", 0, "a"), plugin.open("run", 1, "b"), plugin.open("other", 0, "c")]
    assert plugin.end("run", "part 1 failed", failed=True) == 2
    assert [type(box.ended) for box in boxes] == [PeerFailedError, PeerFailedError, type(None)]


def test_a_task_that_nobody_waits_for_ends_its_run() -> None:
    plugin = Messages()
    plugin.setup(WorkerOfTasks("a", "b"))  # type: ignore[arg-type]
    first, second = plugin.open("run", 0, "a"), plugin.open("other", 0, "b")
    plugin.transition("a", "executing", "memory")
    assert first.ended is None
    plugin.transition("a", "executing", "cancelled")
    assert isinstance(first.ended, PeerLostError)
    assert second.ended is None


def test_a_task_that_was_given_up_before_it_began_ends_at_once() -> None:
    plugin = Messages()
    plugin.setup(WorkerOfTasks())  # type: ignore[arg-type]
    with pytest.raises(PeerLostError, match="given up before this part began"):
        plugin.open("run", 0, "a").take(1, "a")


# The task of one part.


def number(channel: Any, more: int) -> int:
    return channel.number + more


def submitted(client: Client, identity: str, address: str) -> Any:
    seat = Seat(run="run", number=0, addresses=(address,), identity=identity, key=f"key-{identity}")
    return client.submit(run_part, seat, number, (5,), key=seat.key, workers=[address])


def test_it_returns_what_its_function_returns_and_removes_its_box(client: Client) -> None:
    worker = examine_workers(client)[0]
    assert submitted(client, worker.identity, worker.address).result() == 5
    assert client.run(lambda dask_worker: len(dask_worker.plugins["equimesh-messages"].boxes)) == dict.fromkeys(
        client.nthreads(), 0
    )


def test_a_worker_that_was_started_again_does_not_join_the_run(client: Client) -> None:
    worker = examine_workers(client)[0]
    with pytest.raises(PeerLostError, match="ended, and with it part 0"):
        submitted(client, "another process", worker.address).result()


# Reports of parts on their way to the driver.


def report(client: Client, run: str, value: Any) -> None:
    client.log_event(TOPIC, {"run": run, "number": 1, "value": pickle.dumps(value)})


def test_reports_reach_the_listener_of_their_run_only(client: Client) -> None:
    seen: list[tuple[str, int, Any]] = []
    both = threading.Event()

    def listener(name: str, last: int) -> Any:
        def hear(number: int, value: Any) -> None:
            seen.append((name, number, value))
            if value == last:
                both.set()

        return hear

    with listening(client, "a", listener("a", -1)):
        with listening(client, "b", listener("b", 3)):
            report(client, "a", 1)
            report(client, "nobody", 2)
            report(client, "b", 3)
            assert both.wait(5)
        both.clear()
        report(client, "b", 4)
        report(client, "a", -1)
        assert both.wait(5)
    assert seen == [("a", 1, 1), ("b", 1, 3), ("a", 1, -1)]
