"""The callers of requests by their API keys, and the limits of each key."""

from __future__ import annotations

import math
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from starlette.concurrency import run_in_threadpool

from equimesh_service.errors import QuotaError
from equimesh_service.problems.problem import Problem
from equimesh_service.settings import Settings
from equimesh_service.store.keys import (
    ADMIN,
    DEFAULT_SHARE,
    SCOPES,
    KeyStore,
    Quota,
    QuotaStore,
    digest,
    expand_scopes,
    id_of,
)

# How long a caller is cached: after this time a revoked key is refused, and the first key closes an open service.
_CACHE_SECONDS = 1.0
# The most secrets in the cache, valid and invalid.
_MAX_CACHED = 1000


@dataclass(frozen=True)
class Caller:
    """The caller of a request: the id of an API key ("" for none), its scopes, the hash of its secret, its share."""

    key_id: str
    scopes: frozenset[str]
    mark: str = field(default="", repr=False)
    share: int = DEFAULT_SHARE

    @property
    def admin(self) -> bool:
        """Whether the caller sees the meshes and samples of all keys."""
        return ADMIN in self.scopes

    def sees(self, key_id: str) -> bool:
        """Whether the caller sees what belongs to this key."""
        return self.admin or key_id == self.key_id

    @property
    def only(self) -> str | None:
        """The key whose meshes and samples the caller sees; None for all keys."""
        return None if self.admin else self.key_id


ANYONE = Caller("", frozenset(SCOPES))


class Callers:
    """Identifies callers by their secrets. For one event loop; ``clock`` returns monotonic seconds."""

    def __init__(self, store: KeyStore, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._store = store
        self._clock = clock
        self._cache: OrderedDict[str, tuple[Caller | None, float]] = OrderedDict()  # by the hashes of secrets
        self._exist = False
        self._looked_at = float("-inf")

    async def identify(self, secret: str | None) -> Caller:
        """The caller with this secret, :data:`ANYONE` before the first key is created; raises a 401 problem."""
        key_id = None if secret is None else id_of(secret)
        caller = None if secret is None or key_id is None else await self._find(key_id, digest(secret))
        if caller is not None:
            return caller
        if not await self.keys_exist():
            return ANYONE
        detail = "This needs an API key." if secret is None else "This API key is not known, or was revoked."
        raise Problem("unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})

    async def is_valid(self, caller: Caller) -> bool:
        """Whether a caller who was identified earlier is still allowed in."""
        if caller.key_id:
            return await self._find(caller.key_id, caller.mark) is not None
        return not await self.keys_exist()

    async def keys_exist(self) -> bool:
        """Whether a key was ever created, so that every request needs one; true a second after the first at most."""
        now = self._clock()
        if not self._exist and now - self._looked_at >= _CACHE_SECONDS:
            self._exist = await run_in_threadpool(self._store.exist)  # once true, it stays true
            self._looked_at = now
        return self._exist

    async def _find(self, key_id: str, mark: str) -> Caller | None:
        """The caller with this key and this hash; None for an unknown or revoked key. Most calls need no query."""
        now = self._clock()
        found = self._cache.get(mark)
        if found is not None and now < found[1]:
            return found[0]
        row = await run_in_threadpool(self._store.get, key_id)
        caller = None
        if row is not None and row.is_valid(mark):
            caller = Caller(key_id, expand_scopes(row.scopes), mark, row.share)
        # From before the query, so that a key that is revoked during it is refused in time.
        self._cache[mark] = (caller, now + _CACHE_SECONDS)
        self._cache.move_to_end(mark)
        while len(self._cache) > _MAX_CACHED:
            self._cache.popitem(last=False)
        return caller


_MINUTE_SECONDS = 60
# Stored bytes are summed again after this time.
_SUM_SECONDS = 5.0
# They are summed again no sooner than after this many times the duration of the last sum.
_SUM_COST_RATIO = 50.0
# Deleted bytes count no longer than this.
_MIN_SUM_SECONDS = 0.5
# The value of Retry-After where it is not 10. Waits end soon; bytes are freed only when they are deleted.
_RETRY_SECONDS = {"key_max_bytes": "3600", "key_max_waits": "2"}
_LIMITS = {
    "key_max_queued": ("unfinished meshes", "wait until some are finished, or cancel some"),
    "key_max_points": ("points in unfinished meshes", "wait until some are finished, or request fewer points"),
    "key_max_waits": ("open waits and event streams", "wait until some have ended, or send requests that do not wait"),
    "key_max_bytes": ("bytes in files, samples and specs", "delete meshes and samples that are no longer needed"),
}


class _Minute:
    """The numbers of requests in each of the last 60 seconds."""

    def __init__(self) -> None:
        self.total = 0
        self._seconds: deque[tuple[int, int]] = deque()  # pairs of a second and its requests

    def drop(self, now: float) -> None:
        """Drop requests that are more than a minute old."""
        while self._seconds and self._seconds[0][0] < math.floor(now) - _MINUTE_SECONDS:
            self.total -= self._seconds.popleft()[1]

    def add(self, now: float) -> None:
        """Count a request."""
        second, number = math.floor(now), 0
        if self._seconds and self._seconds[-1][0] == second:
            number = self._seconds.pop()[1]
        self._seconds.append((second, number + 1))
        self.total += 1

    def seconds_to_drop(self, now: float) -> int:
        """Seconds until the oldest requests are dropped."""
        oldest = self._seconds[0][0] if self._seconds else math.floor(now)
        return max(1, math.ceil(oldest + _MINUTE_SECONDS + 1 - now))


@dataclass(frozen=True)
class _Sum:
    """The stored bytes of a key: the last sum and what was added since.

    It is used up to the time ``until``. From the time ``again`` on, bytes are summed again before a request is refused.
    """

    size: int
    until: float
    again: float


class Quotas:
    """The limits of all keys. For one event loop; ``clock`` returns monotonic seconds.

    Callers without a key share one limit of waits. Apart from it they have only the limits of the service.
    """

    def __init__(self, settings: Settings, store: QuotaStore, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings, self._store, self._clock = settings, store, clock
        self._minutes: dict[str, _Minute] = {}
        self._sums: dict[str, _Sum] = {}
        self._waits: Counter[str] = Counter()

    def count_request(self, caller: Caller) -> dict[str, str]:
        """Headers with the number of requests that are left; raises a 429 problem when none is."""
        most = self._settings.key_requests_per_minute
        if not caller.key_id or not most:
            return {}
        now, minute = self._clock(), self._minutes.setdefault(caller.key_id, _Minute())
        minute.drop(now)
        if minute.total < most:
            minute.add(now)
        else:
            wait = minute.seconds_to_drop(now)
            detail = (
                f"This key has reached its limit of {most} requests a minute (EQUIMESH_KEY_REQUESTS_PER_MINUTE): "
                f"try again in {wait} seconds; one GET /v1/meshes gives the states of many meshes."
            )
            raise Problem("rate-limited", detail, headers={**_rate(most, 0, wait), "Retry-After": str(wait)})
        return _rate(most, most - minute.total, minute.seconds_to_drop(now))

    def mesh_quota(self, in_flight: tuple[str, ...] = ()) -> Quota:
        """The limits of a key for :meth:`MeshesStore.add`, which has meshes ``in_flight``."""
        limits = self._settings
        return Quota(
            queued=limits.key_max_queued,
            points=limits.key_max_points,
            in_flight=in_flight,
            most_points=limits.max_points,
        )

    @contextmanager
    def count_wait(self, caller: Caller, seconds: float) -> Iterator[None]:
        """Count a wait of the caller; one of 0 ``seconds`` does not count. Raises a 429 problem at the limit."""
        key_id, most = caller.key_id, self._settings.key_max_waits
        if not (seconds and most):
            yield
            return
        if self._waits[key_id] >= most:
            who = "This key has" if key_id else "Callers without a key have"
            raise quota_problem(QuotaError("key_max_waits", self._waits[key_id], most), who)
        self._waits[key_id] += 1
        try:
            yield
        finally:
            self._waits[key_id] -= 1
            if not self._waits[key_id]:
                del self._waits[key_id]

    async def check_bytes(self, caller: Caller, more: int = 0) -> None:
        """Raise a 429 problem when the caller has reached its limit of stored bytes, or would with ``more`` bytes."""
        most = self._settings.key_max_bytes
        if not caller.key_id or not most:
            return
        now, more = self._clock(), max(1, more)
        found = self._sums.get(caller.key_id)
        if found is None or now >= found.until or (found.size + more > most and now >= found.again):
            size = await run_in_threadpool(self._store.stored_bytes, caller.key_id)
            took = self._clock() - now
            wait = _SUM_COST_RATIO * took
            found = _Sum(size, now + max(_SUM_SECONDS, wait), now + max(_MIN_SUM_SECONDS, wait))
        fits = found.size + more <= most
        self._sums[caller.key_id] = replace(found, size=found.size + more) if fits else found
        if not fits:
            raise quota_problem(QuotaError("key_max_bytes", found.size, most))


def _rate(most: int, left: int, seconds: int) -> dict[str, str]:
    return {"RateLimit-Policy": f'"key";q={most};w={_MINUTE_SECONDS}', "RateLimit": f'"key";r={left};t={seconds}'}


def quota_problem(error: QuotaError, who: str = "This key has") -> Problem:
    """The 429 problem for a limit that is reached."""
    what, remedy = _LIMITS[error.limit]
    detail = f"{who} {error.used} {what}; the limit is {error.most} (EQUIMESH_{error.limit.upper()}): {remedy}."
    return Problem("quota-exceeded", detail, headers={"Retry-After": _RETRY_SECONDS.get(error.limit, "10")})
