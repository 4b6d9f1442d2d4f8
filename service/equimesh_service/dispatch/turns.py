"""The turns of keys: however many tasks one key has waiting, the next task of another key is not delayed by them.

First is the key with the fewest running tasks for its share. Among equals, keys take turns by start tags (start-time
fair queueing: Goyal, Vin and Cheng, SIGCOMM 1996): each start moves the tag of its key by one over its share.
"""

from collections import OrderedDict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class Contender:
    """A key with waiting tasks, its share, and the number of its running tasks."""

    key_id: str
    share: int = 1
    running: int = 0


class Turns:
    """The turns of the keys of one service. Tags are numbers without a unit; callers hold a lock.

    A key that has not started anything for a while is first among its equals, and gains nothing more by its wait.
    """

    def __init__(self) -> None:
        self._latest = 0.0  # the largest start tag up to now
        self._next: dict[str, float] = {}  # the next start tag of each key whose tag is later than the latest

    def first(self, contenders: Iterable[Contender]) -> Contender:
        """The contender whose turn it is; the first of equal ones."""
        return min(contenders, key=self._place)

    def start(self, key_id: str, share: int = 1) -> None:
        """Note that a task of a key starts."""
        self._latest = max(self._latest, self._next.get(key_id, 0.0))
        self._next[key_id] = self._latest + 1.0 / share
        # Earlier tags would count as the latest one.
        self._next = {key: tag for key, tag in self._next.items() if tag > self._latest}

    def _place(self, contender: Contender) -> tuple[float, float]:
        return contender.running / contender.share, self._next.get(contender.key_id, 0.0)


class KeyedLine(Generic[Item]):
    """Items that wait, each of a key; those of one key in the order in which they came."""

    def __init__(self) -> None:
        self._items: OrderedDict[str, deque[Item]] = OrderedDict()  # by key; the key that was served last comes last
        self._shares: dict[str, int] = {}
        self._length = 0

    def __len__(self) -> int:
        return self._length

    def add(self, key_id: str, item: Item, share: int = 1) -> None:
        """Add an item at the end of its key's line."""
        self._items.setdefault(key_id, deque()).append(item)
        self._shares[key_id] = share
        self._length += 1

    def remove(self, item: Item) -> bool:
        """Remove an item; False when it does not wait."""
        for key_id, items in self._items.items():
            if item in items:
                items.remove(item)
                self._shrink(key_id)
                return True
        return False

    def pop(self, key_id: str) -> Item:
        """Remove and return the first item of a key."""
        item = self._items[key_id].popleft()
        self._items.move_to_end(key_id)
        self._shrink(key_id)
        return item

    def pop_all(self) -> list[Item]:
        """Remove and return all items."""
        return [self.pop(key_id) for key_id, items in list(self._items.items()) for _ in range(len(items))]

    def contenders(self, running: Mapping[str, int]) -> list[Contender]:
        """The keys with waiting items, given the number of running tasks of each key."""
        return [
            Contender(key_id=key_id, share=self._shares[key_id], running=running.get(key_id, 0))
            for key_id in self._items
        ]

    def _shrink(self, key_id: str) -> None:
        self._length -= 1
        if not self._items[key_id]:
            del self._items[key_id], self._shares[key_id]
