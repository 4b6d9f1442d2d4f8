"""Messages between the parts of one computation: the port, and two channels inside one process.

All parts run the same program on different rows. A part sends arrays to another one, and receives what that one sent
to it under the same tag. Messages of one sender under one tag arrive in the order in which they were sent; so a tag
says of which kind a message is, and is used again in every sweep.
"""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from equimesh.errors import EquimeshError
from equimesh.numerics.types import Array

T = TypeVar("T")


class PeerError(EquimeshError):
    """Another part of the computation has ended, so that its messages will not come: see the two kinds of it.

    The computation failed for the reason that the other part has; callers report that one, not this.
    """


class PeerFailedError(PeerError):
    """Another part raised an error; the message has its text."""


class PeerLostError(PeerError):
    """The process of another part has gone, or has ended without the message that this part waits for."""


class Channel(Protocol):
    """The connection of one part to the others."""

    @property
    def number(self) -> int:
        """The number of this part, from 0."""
        ...

    @property
    def count(self) -> int:
        """The number of parts."""
        ...

    def send(self, to: int, tag: str, arrays: Sequence[Array]) -> None:
        """Send copies of ``arrays`` to the part ``to``. Returns at once; the sender may change its arrays then."""
        ...

    def receive(self, sender: int, tag: str) -> Sequence[Array]:
        """The arrays of the next message from ``sender`` under ``tag``; waits for it.

        Raises :class:`PeerFailedError` or :class:`PeerLostError` where it cannot come any more.
        """
        ...


class Alone:
    """The channel of a computation in one part, which sends nothing."""

    number, count = 0, 1

    def send(self, to: int, tag: str, arrays: Sequence[Array]) -> None:
        """Refused: there is no other part."""
        raise AssertionError(f"a single part sends nothing, not {len(arrays)} arrays of {tag} to part {to}")

    def receive(self, sender: int, tag: str) -> Sequence[Array]:
        """Refused: there is no other part."""
        raise AssertionError(f"a single part receives nothing, not {tag} from part {sender}")


ALONE = Alone()


@dataclass
class Traffic:
    """The messages that a part has sent, and their bytes."""

    messages: int = 0
    bytes: int = 0


def added(counts: Iterable[Mapping[str, Traffic]]) -> dict[str, Traffic]:
    """The sum of what several parts sent, or of several records, by the kind of the message."""
    total = defaultdict[str, Traffic](Traffic)
    for one in counts:
        for kind, traffic in one.items():
            total[kind].messages += traffic.messages
            total[kind].bytes += traffic.bytes
    return dict(total)


class Counted:
    """A channel that counts what its part sends, by tag, in :attr:`sent`."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self.number, self.count = channel.number, channel.count
        self.sent: dict[str, Traffic] = defaultdict(Traffic)

    def send(self, to: int, tag: str, arrays: Sequence[Array]) -> None:
        """As :meth:`Channel.send`."""
        self._channel.send(to, tag, arrays)
        here = self.sent[tag]
        here.messages += 1
        here.bytes += sum(array.nbytes for array in arrays)

    def receive(self, sender: int, tag: str) -> Sequence[Array]:
        """As :meth:`Channel.receive`."""
        return self._channel.receive(sender, tag)

    def taken(self) -> dict[str, Traffic]:
        """The traffic since the last call, by tag."""
        sent, self.sent = dict(self.sent), defaultdict(Traffic)
        return sent


class ThreadChannels:
    """The channels of ``count`` parts that are threads of this process; each can be used for one run."""

    def __init__(self, count: int) -> None:
        self._waiting: dict[tuple[int, int, str], deque[list[Array]]] = defaultdict(deque)
        self._changed = threading.Condition()
        self._ended: dict[int, BaseException | None] = {}
        self.channels = [_ThreadChannel(self, number, count) for number in range(count)]

    def run(self, work: Callable[[Channel], T]) -> list[T]:
        """The results of ``work`` for the channel of every part, each on its own thread.

        Raises the error of the part that failed first; the parts that waited for it end with a :class:`PeerError`.
        """
        errors: list[BaseException] = []

        def one(channel: _ThreadChannel) -> T:
            error: BaseException | None = None
            try:
                return work(channel)
            except BaseException as raised:
                error = raised
                raise
            finally:
                with self._changed:
                    self._ended[channel.number] = error
                    errors.extend([error] if error is not None else [])
                    self._changed.notify_all()

        with ThreadPoolExecutor(len(self.channels), thread_name_prefix="equimesh-part") as pool:
            futures = [pool.submit(one, channel) for channel in self.channels]
        if errors:
            raise next((error for error in errors if not isinstance(error, PeerError)), errors[0])
        return [future.result() for future in futures]

    def put(self, key: tuple[int, int, str], arrays: list[Array]) -> None:
        """Store a message under its receiver, sender and tag."""
        with self._changed:
            self._waiting[key].append(arrays)
            self._changed.notify_all()

    def take(self, key: tuple[int, int, str]) -> list[Array]:
        """The next message with this receiver, sender and tag; waits for it."""
        _, sender, tag = key
        with self._changed:
            while not self._waiting[key]:
                failed = next((k for k, error in self._ended.items() if error is not None), None)
                if failed is not None:
                    raise PeerFailedError(f"part {failed} failed: {self._ended[failed]}")
                if sender in self._ended:
                    raise PeerLostError(f"part {sender} ended without sending {tag!r}")
                self._changed.wait()
            return self._waiting[key].popleft()


class _ThreadChannel:
    """The channel of one thread."""

    def __init__(self, board: ThreadChannels, number: int, count: int) -> None:
        self._board, self.number, self.count = board, number, count

    def send(self, to: int, tag: str, arrays: Sequence[Array]) -> None:
        if not 0 <= to < self.count or to == self.number:
            raise ValueError(f"part {self.number} of {self.count} cannot send to part {to}")
        self._board.put((to, self.number, tag), [np.array(array, order="C") for array in arrays])

    def receive(self, sender: int, tag: str) -> Sequence[Array]:
        return self._board.take((self.number, sender, tag))


# What the parts of one computation agree on.


def agree(channel: Channel, *numbers: float) -> tuple[float, ...]:
    """The largest of each of the numbers over all processes, the same for all; NaN where one of them is NaN.

    In round r every process tells the one 2^r further what it knows so far. After the logarithm of their number, all
    know all.
    """
    known, step = np.array(numbers, dtype=np.float64), 1
    while step < channel.count:
        channel.send((channel.number + step) % channel.count, "agree", [known])
        (others,) = channel.receive((channel.number - step) % channel.count, "agree")
        known, step = np.maximum(known, others), 2 * step
    return tuple(known.tolist())


def gather(channel: Channel, tag: str, arrays: Sequence[Array]) -> list[list[Array]]:
    """The arrays of every process, in the order of the processes, the same for all.

    Every process sends to the one 2^r further what it has so far, without what that one has already.
    """
    number, count = channel.number, channel.count
    known, step = [list(arrays)], 1  # those of this process, of the one before it, and so on around
    while step < count:
        new = known[: count - step]
        channel.send((number + step) % count, tag, [array for one in new for array in one])
        received = channel.receive((number - step) % count, tag)
        known += [list(received[k : k + len(arrays)]) for k in range(0, len(received), len(arrays))]
        step *= 2
    return [known[(number - k) % count] for k in range(count)]


# What the parts of one computation found, joined or added, and known to every part.
#
# All parts make the same calls in the same order, and decide from the same numbers.

TAG = "measure"
"""The tag of the messages."""


def gathered(channel: Channel, array: Array) -> Sequence[Array]:
    """The arrays of all parts, in their order."""
    return [found for (found,) in gather(channel, TAG, [array])]


def joined(channel: Channel, array: Array) -> Array:
    """The rows of all parts, one part after the other."""
    return array if channel.count == 1 else np.concatenate(gathered(channel, array))


def summed(channel: Channel, array: Array) -> Array:
    """The sum of the arrays of all parts, which have one shape; added in the order of the parts."""
    return array if channel.count == 1 else np.asarray(np.sum(np.stack(gathered(channel, array)), axis=0))
