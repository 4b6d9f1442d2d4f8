"""The task of one part: it runs on a worker, from the opening of its channel to its result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from distributed import get_worker

from equimesh.numerics.channel import PeerLostError
from equimesh_cluster.channel import Seat, WorkerChannel
from equimesh_cluster.messages import plugin_of


def run_part(seat: Seat, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """The result of ``function(channel, *arguments)`` for one part.

    Raises :class:`~equimesh.numerics.channel.PeerLostError` where the run has ended, or where the worker has
    ended since: Dask then runs the task on another one.
    """
    worker = get_worker()
    if worker.id != seat.identity:
        raise PeerLostError(f"the worker at {seat.addresses[seat.number]} ended, and with it part {seat.number}")
    plugin = plugin_of(worker)
    box = plugin.open(seat.run, seat.number, seat.key)
    try:
        channel = WorkerChannel(seat, worker, plugin, box)
        result = function(channel, *arguments)
        channel.flush()
        return result
    finally:
        plugin.close(seat.run, seat.number)
