"""Who asks: the caller behind a request, and the short memory that spares the store most questions about keys."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from starlette.concurrency import run_in_threadpool

from equimesh_service.key_store import KeyStore
from equimesh_service.keys import ADMIN, SCOPES, allowed, digest, id_of
from equimesh_service.problems import Problem

# A revoked key works no longer than this, and a first key closes an open service this soon.
_REMEMBERED_SECONDS = 1.0
# Secrets, good and bad, that are remembered at most.
_REMEMBERED = 1000


@dataclass(frozen=True)
class Caller:
    """Who asks: the id of an API key ("" where none is asked for), and all that it allows."""

    key_id: str
    scopes: frozenset[str]

    @property
    def admin(self) -> bool:
        """Whether all meshes and samples are the caller's to see."""
        return ADMIN in self.scopes

    def sees(self, key_id: str) -> bool:
        """Whether what belongs to this key is there for the caller."""
        return self.admin or key_id == self.key_id

    @property
    def only(self) -> str | None:
        """The one key whose things the caller sees; None for all."""
        return None if self.admin else self.key_id


ANYONE = Caller("", frozenset(SCOPES))


class Callers:
    """Tells callers by their secrets. For one event loop; ``clock`` gives seconds that only grow."""

    def __init__(self, store: KeyStore, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._store = store
        self._clock = clock
        self._known: OrderedDict[str, tuple[Caller | None, float]] = OrderedDict()  # by the hashes of secrets
        self._needed = False
        self._asked_at = float("-inf")

    async def identify(self, secret: str | None) -> Caller:
        """The caller with this secret; raises a 401 problem. While no key was ever created, anyone."""
        if secret is None:
            if await self._keys_needed():
                raise _unauthorized("This needs an API key.")
            return ANYONE
        key_id = id_of(secret)
        caller = None if key_id is None else await self._remembered(key_id, secret)
        if caller is None:
            raise _unauthorized("This API key is not known, or was revoked.")
        return caller

    async def _keys_needed(self) -> bool:
        now = self._clock()
        if not self._needed and now - self._asked_at >= _REMEMBERED_SECONDS:
            self._needed = await run_in_threadpool(self._store.exist)  # once true it stays so
            self._asked_at = now
        return self._needed

    async def _remembered(self, key_id: str, secret: str) -> Caller | None:
        mark, now = digest(secret), self._clock()
        found = self._known.get(mark)
        if found is not None and now < found[1]:
            return found[0]
        row = await run_in_threadpool(self._store.get, key_id)
        good = row is not None and row.opened_by(secret)
        caller = Caller(key_id, allowed(row.scopes)) if good and row is not None else None
        # The time counts from before the look: a key that is revoked after it is in force no longer than that.
        self._known[mark] = (caller, now + _REMEMBERED_SECONDS)
        self._known.move_to_end(mark)
        while len(self._known) > _REMEMBERED:
            self._known.popitem(last=False)
        return caller


def _unauthorized(detail: str) -> Problem:
    return Problem("unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})
