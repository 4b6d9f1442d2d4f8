"""Boxes of messages, and the plugin that fills them."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from equimesh.numerics.channel import PeerFailedError, PeerLostError
from equimesh_cluster.channel import Box, Messages


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
