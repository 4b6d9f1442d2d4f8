"""Readiness: whether the parts of a service work; each is tried at most once a second."""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping, Sequence

from anyio import CapacityLimiter, move_on_after, to_thread

from equimesh_service.problems.storage import storage_problem
from equimesh_service.telemetry.logs import describe_error

_log = logging.getLogger(__name__)
OK = "ok"
# How long results are reused.
_CACHE_SECONDS = 1.0
# A part that takes longer is not ready.
_MAX_CHECK_SECONDS = 5.0


class Readiness:
    """Runs ``checks``, by name. Each returns None, "ok" or a message, and may raise and block.

    Each of ``warn`` returns a sentence about what is wrong but stops no work, or None; it returns at once. ``warm_up``
    returns how many loops are "compiled" and "of" how many while the workers warm up, then None; within milliseconds.
    """

    def __init__(
        self,
        checks: Mapping[str, Callable[[], str | None]],
        *,
        warn: Sequence[Callable[[], str | None]] = (),
        warm_up: Callable[[], Mapping[str, int] | None] = lambda: None,
        timeout: float = _MAX_CHECK_SECONDS,
    ) -> None:
        self._checks = checks
        self._warn = warn
        self.warm_up = warm_up
        self._timeout = timeout
        self._lock = asyncio.Lock()
        self._results: dict[str, str] = {}
        self._checked_at = float("-inf")
        # Threads of their own, so that checks that hang take none from requests.
        self._limiter = CapacityLimiter(len(checks))

    def warnings(self) -> list[str]:
        """Sentences about what is wrong but stops no work."""
        return [warning for warn in self._warn if (warning := warn()) is not None]

    async def check(self) -> Mapping[str, str]:
        """The result of each check; simultaneous callers share one run."""
        async with self._lock:
            if time.monotonic() - self._checked_at >= _CACHE_SECONDS:
                results = await asyncio.gather(*(self._try(name, check) for name, check in self._checks.items()))
                self._results = dict(zip(self._checks, results, strict=True))
                self._checked_at = time.monotonic()
            return self._results

    async def _try(self, name: str, check: Callable[[], str | None]) -> str:
        with move_on_after(self._timeout):
            try:
                result = await to_thread.run_sync(check, abandon_on_cancel=True, limiter=self._limiter)
                return OK if result is None else result
            except Exception as error:
                problem = storage_problem(error)
                if problem is not None:
                    return problem.detail
                # The answer holds only the type: the message may hold paths and addresses.
                _log.warning("not ready, %s: %s", name, describe_error(error))
                return f"does not work ({type(error).__name__}); see the service's log"
        return f"no answer within {self._timeout:g} s"
