"""Limits for each API key: what it may have, and how often it may ask."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from starlette.concurrency import run_in_threadpool

from equimesh_service.callers import Caller
from equimesh_service.problems import Problem
from equimesh_service.quota_store import Quota, QuotaError, QuotaStore
from equimesh_service.settings import Settings

_MINUTE = 60.0
# Bytes are summed anew after so many seconds, or after so many times as long as the sum took.
_SUM_SECONDS, _SUM_SHARE = 5.0, 50.0
_WHAT = {
    "key_max_queued": ("unfinished meshes", "wait until some are finished, or cancel some"),
    "key_max_points": ("points in unfinished meshes", "wait until some are finished, or ask for fewer points"),
    "key_max_bytes": ("bytes in files and samples", "delete meshes and samples that are no longer needed"),
}


@dataclass
class _Window:
    """Requests in this minute of a key, and in the one before it."""

    minute: int
    now: int = 0
    before: int = 0


@dataclass(frozen=True)
class _Sum:
    """Stored bytes of a key, and until when they are taken for true."""

    size: int
    until: float


class Quotas:
    """The limits of all keys. For one event loop; the caller without a key has none but the service's own.

    ``clock`` gives seconds that only grow.
    """

    def __init__(self, settings: Settings, store: QuotaStore, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings, self._store, self._clock = settings, store, clock
        self._windows: dict[str, _Window] = {}
        self._sums: dict[str, _Sum] = {}

    def count_request(self, caller: Caller) -> dict[str, str]:
        """The headers that say how many requests are left; raises a 429 problem when none is.

        The last 60 seconds hold, about, the requests of this minute and a share of those of the minute before.
        """
        most = self._settings.key_requests_per_minute
        if not caller.key_id or not most:
            return {}
        minute, part = divmod(self._clock() / _MINUTE, 1.0)
        window = self._window(caller.key_id, int(minute))
        carried = window.before * (1.0 - part)
        left = math.floor(most - carried - window.now)
        policy = {"RateLimit-Policy": f'"key";q={most};w=60'}
        if left < 1:
            wait = self._wait(window, part, most)
            raise Problem(
                "rate-limited",
                f"This key may send {most} requests a minute (EQUIMESH_KEY_REQUESTS_PER_MINUTE) and has sent them; "
                f"try again in {wait} seconds, or ask for several meshes' states with one GET /v1/meshes.",
                headers={**policy, "RateLimit": f'"key";r=0;t={wait}', "Retry-After": str(wait)},
            )
        window.now += 1
        return {**policy, "RateLimit": f'"key";r={left - 1};t={math.ceil((1.0 - part) * _MINUTE)}'}

    def for_mesh(self, caller: Caller) -> Quota | None:
        """What :meth:`MeshesStore.add` is to hold this caller to."""
        if not caller.key_id:
            return None
        return Quota(queued=self._settings.key_max_queued, points=self._settings.key_max_points)

    async def check_bytes(self, caller: Caller, more: int = 0) -> None:
        """Raise a 429 problem when the caller has stored as much as it may, or would with ``more`` bytes."""
        most = self._settings.key_max_bytes
        if not caller.key_id or not most:
            return
        now = self._clock()
        found = self._sums.get(caller.key_id)
        if found is None or now >= found.until:
            size = await run_in_threadpool(self._store.stored_bytes, caller.key_id)
            took = self._clock() - now
            found = _Sum(size, now + max(_SUM_SECONDS, _SUM_SHARE * took))
        if found.size + max(1, more) > most:
            # Who has deleted something is not to wait for a new sum.
            self._sums.pop(caller.key_id, None)
            raise exceeded(QuotaError("key_max_bytes", found.size, most))
        self._sums[caller.key_id] = _Sum(found.size + more, found.until)

    def _window(self, key_id: str, minute: int) -> _Window:
        window = self._windows.get(key_id)
        if window is None or window.minute != minute:
            before = window.now if window is not None and window.minute == minute - 1 else 0
            window = self._windows[key_id] = _Window(minute, before=before)
        return window

    @staticmethod
    def _wait(window: _Window, part: float, most: int) -> int:
        """Seconds until one more request fits."""
        if window.now < most and window.before:
            free = 1.0 - (most - window.now - 1) / window.before  # the part of the minute at which it does
            return max(1, math.ceil((min(1.0, free) - part) * _MINUTE))
        # This minute is full: of the next one a share has to pass before the same is true of it.
        return max(1, math.ceil((1.0 - part + 1.0 / max(1, window.now)) * _MINUTE))


def exceeded(error: QuotaError) -> Problem:
    """The 429 problem of a limit that is reached."""
    what, remedy = _WHAT[error.limit]
    detail = f"This key has {error.used} {what}, and may have {error.most} (EQUIMESH_{error.limit.upper()}): {remedy}."
    return Problem("quota-exceeded", detail, headers={"Retry-After": "10"})
