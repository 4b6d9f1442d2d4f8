"""Whether a service can do its work: each part is tried for real, and the answer kept for a second."""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping

from anyio import CapacityLimiter, move_on_after, to_thread

from equimesh_service.problems.storage import storage_problem
from equimesh_service.telemetry.logs import describe_error

_log = logging.getLogger(__name__)
OK = "ok"
# The parts are tried at most once in this time, however often probes ask.
_KEPT_SECONDS = 1.0
_MAX_CHECK_SECONDS = 5.0


class Readiness:
    """Tries ``checks``, by name. Each gives None, "ok" or what is wrong, and may raise and block."""

    def __init__(self, checks: Mapping[str, Callable[[], str | None]], *, patience: float = _MAX_CHECK_SECONDS) -> None:
        self._checks = checks
        self._patience = patience
        self._lock = asyncio.Lock()
        self._found: dict[str, str] = {}
        self._at = float("-inf")
        # Threads of their own: a check that hangs takes none from the requests.
        self._limiter = CapacityLimiter(len(checks))

    async def check(self) -> Mapping[str, str]:
        """What each check says; all that ask at the same time share one look."""
        async with self._lock:
            if time.monotonic() - self._at >= _KEPT_SECONDS:
                said = await asyncio.gather(*(self._try(name, check) for name, check in self._checks.items()))
                self._found = dict(zip(self._checks, said, strict=True))
                self._at = time.monotonic()
            return self._found

    async def _try(self, name: str, check: Callable[[], str | None]) -> str:
        with move_on_after(self._patience):
            try:
                said = await to_thread.run_sync(check, abandon_on_cancel=True, limiter=self._limiter)
                return OK if said is None else said
            except Exception as error:
                problem = storage_problem(error)
                if problem is not None:
                    return problem.detail
                # No more than the kind in the answer: its words may hold paths and addresses.
                _log.warning("not ready, %s: %s", name, describe_error(error))
                return f"does not work ({type(error).__name__}); see the service's log"
        return f"no answer within {self._patience:g} s"
