"""The channel between tasks on workers: order, copies, many and large messages."""

from __future__ import annotations

import pickle
import threading
from typing import Any

import numpy as np
import pytest
from distributed import Client

from dask_processes import DaskProcesses
from equimesh import Grid
from equimesh_cluster import channel as module
from equimesh_cluster import run_parts
from equimesh_cluster.channel import TOPIC, Box, Messages, Seat, listening, run_part
from equimesh_cluster.messages import (
    ALONE,
    TAG,
    Channel,
    Counted,
    PeerFailedError,
    PeerLostError,
    ThreadChannels,
    Traffic,
    gathered,
    joined,
    summed,
)
from equimesh_cluster.parts.part_solution import PartStep
from equimesh_cluster.solving import PartsProgress, Progress
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
            assert both.wait(60)
        both.clear()
        report(client, "b", 4)
        report(client, "a", -1)
        assert both.wait(60)
    assert seen == [("a", 1, 1), ("b", 1, 3), ("a", 1, -1)]


def test_messages_arrive_in_order_and_by_tag() -> None:
    def work(channel: Channel) -> list[float]:
        if channel.number == 0:
            for k in range(3):
                channel.send(1, "sums", [np.full(2, float(k))])
            channel.send(1, "halo", [np.full(1, 7.0), np.full(1, 8.0)])
            return []
        halo = channel.receive(0, "halo")
        return [*(float(array[0]) for array in halo), *(float(channel.receive(0, "sums")[0][1]) for _ in range(3))]

    assert ThreadChannels(2).run(work)[1] == [7.0, 8.0, 0.0, 1.0, 2.0]


def test_a_message_is_a_copy() -> None:
    changed = threading.Event()

    def work(channel: Channel) -> float:
        if channel.number == 1:
            assert changed.wait(timeout=60)
            return float(channel.receive(0, "row")[0][0])
        row = np.zeros(4)
        channel.send(1, "row", [row[::2]])
        row[:] = 5.0
        changed.set()
        return 0.0

    assert ThreadChannels(2).run(work) == [0.0, 0.0]


def test_the_error_of_a_part_reaches_the_caller_and_its_peers() -> None:
    seen: list[BaseException] = []

    def work(channel: Channel) -> None:
        if channel.number == 2:
            raise ValueError("u is not finite")
        try:
            channel.receive((channel.number + 1) % 3, "never sent")
        except PeerFailedError as error:
            seen.append(error)
            raise

    with pytest.raises(ValueError, match="u is not finite"):
        ThreadChannels(3).run(work)
    assert [str(error) for error in seen] == 2 * ["part 2 failed: u is not finite"]


def test_who_waits_for_a_part_that_has_ended_is_told() -> None:
    def work(channel: Channel) -> Any:
        return channel.receive(0, "sums") if channel.number else None

    with pytest.raises(PeerLostError, match="part 0 ended without sending 'sums'"):
        ThreadChannels(2).run(work)


def test_messages_and_bytes_are_counted_by_tag() -> None:
    def work(channel: Channel) -> list[dict[str, Traffic]]:
        counted = Counted(channel)
        if channel.number == 1:
            for tag in ("halo", "halo", "sums", "halo"):
                counted.receive(0, tag)
            return []
        counted.send(1, "halo", [np.zeros((2, 5)), np.zeros(5)])
        counted.send(1, "halo", [np.zeros(3)])
        counted.send(1, "sums", [np.zeros(1)])
        first = counted.taken()
        counted.send(1, "halo", [np.zeros(2)])
        return [first, counted.taken(), counted.taken()]

    (found, _) = ThreadChannels(2).run(work)
    assert found == [{"halo": Traffic(2, 144), "sums": Traffic(1, 8)}, {"halo": Traffic(1, 16)}, {}]


def test_a_part_sends_to_others_only() -> None:
    for to in (-1, 0, 2):
        with pytest.raises(ValueError, match=f"part 0 of 2 cannot send to part {to}"):
            ThreadChannels(2).channels[0].send(to, "row", [np.zeros(1)])
    with pytest.raises(AssertionError, match="sends nothing"):
        ALONE.send(1, "row", [np.zeros(1)])
    with pytest.raises(AssertionError, match="receives nothing"):
        ALONE.receive(0, "row")
    assert (ALONE.number, ALONE.count) == (0, 1)


# What parts tell all others: the same for each of them, in few messages.


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_all_parts_know_all_in_the_order_of_the_parts(count: int) -> None:
    def work(channel: Channel) -> tuple[np.ndarray, np.ndarray, int]:
        counted = Counted(channel)
        rows = joined(counted, np.full((channel.number, 2), float(channel.number)))
        total = summed(counted, np.array([1.0, 10.0**channel.number]))
        return rows, total, counted.sent[TAG].messages

    expected = np.repeat(np.arange(count, dtype=float), np.arange(count))
    for rows, total, messages in ThreadChannels(count).run(work):
        assert np.array_equal(rows, np.column_stack([expected, expected]))
        assert total.tolist() == [count, float("1" * count)]
        assert messages == 2 * (count - 1).bit_length()


def test_one_part_sends_nothing_and_keeps_its_array() -> None:
    array = np.arange(3.0)
    assert gathered(ALONE, array) == [array]
    assert joined(ALONE, array) is array
    assert summed(ALONE, array) is array


def record(step: int, sent: int) -> PartStep:
    return PartStep(
        level=1,
        levels=2,
        grid=Grid(n_xi=9, n_eta=9),
        step=step,
        residual=0.5,
        algebraic_error=0.0,
        discretization_error=0.0,
        contraction=0.1,
        converged=False,
        traffic={"halo": Traffic(1, sent), "sums": Traffic(2, 10)},
    )


def test_a_step_is_told_once_all_parts_have_sent_theirs() -> None:
    seen: list[Progress] = []
    gathering = PartsProgress(seen.append)
    gathering.begin(2)
    gathering.add(1, record(0, 100))
    gathering.add(1, record(1, 100))
    assert seen == []
    gathering.add(0, record(0, 200))
    assert [(one.step, one.parts, one.messages, one.bytes, one.attempt) for one in seen] == [(0, 2, 6, 320, 1)]
    gathering.begin(1)  # what the first attempt left is forgotten
    gathering.add(0, record(0, 5))
    assert [(one.step, one.parts, one.messages, one.bytes, one.attempt) for one in seen[1:]] == [(0, 1, 3, 15, 2)]
    assert (seen[0].level, seen[0].levels, seen[0].grid, seen[0].residual) == (1, 2, Grid(n_xi=9, n_eta=9), 0.5)


def test_without_an_observer_nothing_is_told() -> None:
    gathering = PartsProgress(None)
    gathering.begin(1)
    gathering.add(0, record(0, 1))
