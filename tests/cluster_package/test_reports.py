"""Reports of parts on their way to the driver."""

from __future__ import annotations

import pickle
import threading
from typing import Any

from distributed import Client

from equimesh_cluster.channel import TOPIC, listening


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
