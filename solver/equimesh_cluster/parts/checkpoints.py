"""Copies of the last iterates of subdomains, with which an iteration continues after a process was lost.

After an iteration every part keeps its windows and the windows of a partner in the memory of its process. They are
kept there after the part has ended. After a loss the parts of the next attempt look for the newest iterate whose
windows are all in the processes that are left.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh_cluster.messages import Channel
from equimesh_cluster.parts.holding import OnChannel

# Iterates of which copies are kept: one part may be one iteration ahead of another.
KEPT_ITERATES = 2
KIND = "kept"
"""The kind of the messages."""


class Checkpoints:
    """The copies of one process, which parts on several threads may share."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._windows: dict[tuple[int, int], tuple[Array, Array]] = {}

    def put(self, iteration: int, subdomain: int, nodes: Sequence[Array]) -> None:
        """Keep a copy of the window of a subdomain after an iteration, and forget the windows of those long before."""
        x, y = (np.array(q) for q in nodes)
        with self._lock:
            self._windows[iteration, subdomain] = x, y
            for key in [key for key in self._windows if key[0] <= iteration - KEPT_ITERATES]:
                del self._windows[key]

    def get(self, iteration: int, subdomain: int) -> tuple[Array, Array]:
        """The copy of a window."""
        return self._windows[iteration, subdomain]

    @property
    def known(self) -> list[tuple[int, int]]:
        """The iterations and subdomains of all copies."""
        with self._lock:
            return sorted(self._windows)


def keep(holding: OnChannel, kept: Checkpoints, iteration: int, mesh: Mesh) -> None:
    """Keep the windows of a merged mesh: here, and at the partner of this part."""
    channel = holding.channel
    # Neighbours in the order of the parts may run on the same machine.
    shift = max(1, channel.count // 2)
    to, sender = (channel.number + shift) % channel.count, (channel.number - shift) % channel.count
    windows = {k: holding.view(mesh, k) for k in holding.numbers}
    if channel.count > 1:
        for window in windows.values():
            channel.send(to, KIND, [window.x, window.y])
    for k, window in windows.items():
        kept.put(iteration, k, [window.x, window.y])
    if channel.count > 1:
        for k in holding.held_by(sender):
            kept.put(iteration, k, channel.receive(sender, KIND))


def resumed(holding: OnChannel, kept: Checkpoints, most: int) -> tuple[int, Mesh] | None:
    """The newest iterate, of iteration ``most`` at most, whose windows are all in the parts.

    Returns the number of its iteration, and the merged mesh of ``holding``; ``None`` where there is none.
    """
    channel, count = holding.channel, len(holding.patches)
    sources = _sources(channel, kept, most, count)
    if sources is None:
        return None
    iteration, found = int(sources[0]), {}
    for k in range(count):

        def copy(k: int = k) -> Sequence[Array]:
            return kept.get(iteration, k)

        nodes = holding.move(int(sources[1 + k]), holding.holder_of(k), copy, KIND)
        if nodes is not None:
            found[k] = Mesh(nodes[0].copy(), nodes[1].copy())
    return iteration, holding.joined(found)


def _sources(channel: Channel, kept: Checkpoints, most: int, subdomains: int) -> Array | None:
    """The newest iteration that is known as a whole, and for every subdomain a part that has its window."""
    known = np.array(kept.known, dtype=np.float64).reshape(-1, 2)
    if channel.number:
        channel.send(0, KIND, [known])
        sources = channel.receive(0, KIND)[0]
        return np.asarray(sources) if sources.size else None
    parts = [known, *(np.asarray(channel.receive(part, KIND)[0]) for part in range(1, channel.count))]
    where: dict[int, dict[int, int]] = {}
    for part, here in enumerate(parts):
        for iteration, k in here.astype(int).tolist():
            where.setdefault(iteration, {}).setdefault(k, part)
    whole = [iteration for iteration, found in where.items() if len(found) == subdomains and iteration <= most]
    sources = np.zeros(0)
    if whole:
        newest = max(whole)
        sources = np.array([newest, *(where[newest][k] for k in range(subdomains))], dtype=np.float64)
    for to in range(1, channel.count):
        channel.send(to, KIND, [sources])
    return sources if sources.size else None
