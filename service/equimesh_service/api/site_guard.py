"""The guard of a service without API keys: it answers for known hosts, and not to pages of other sites.

With keys nothing is checked here: a page of another site has no key, and no browser adds one by itself.
"""

from __future__ import annotations

from typing import cast

from starlette.types import ASGIApp, Receive, Scope, Send

from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_problem
from equimesh_service.service import Service
from equimesh_service.settings import Settings
from equimesh_service.wire.sites import KnownHosts, Sender

# Probes send any host. Their answers tell nothing but that the service works.
_PROBES = frozenset({"/livez", "/readyz"})
# Headers that say who sent a request, with their fields of a sender.
_FIELDS = {
    b"host": "host",
    b"origin": "origin",
    b"sec-fetch-site": "site",
    b"sec-fetch-mode": "mode",
    b"sec-fetch-dest": "destination",
}
# The most characters of a header that a problem repeats.
_MAX_SHOWN = 100


class SiteGuard:
    """ASGI middleware before all routes: 403 for unknown hosts and foreign origins while no key was ever created."""

    def __init__(self, app: ASGIApp, *, settings: Settings) -> None:
        self._app = app
        self._known = KnownHosts([settings.host, *settings.allowed_host_names])

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        problem = self._check(scope) if scope["type"] == "http" else None
        if problem is not None:
            problem = await _unless_keys_exist(problem, scope["app"].state.service)
        if problem is None:
            await self._app(scope, receive, send)
        else:
            await problem.response()(scope, receive, send)

    def _check(self, scope: Scope) -> Problem | None:
        sender = _sender(scope)
        if scope["path"] in _PROBES and sender.method in {"GET", "HEAD"}:
            return None
        if not self._known.has(sender):
            return Problem(
                "unknown-host",
                f"This service needs no API key, so it answers only for hosts that it knows. {_shown(sender.host)} is "
                "not one of them.",
            )
        if sender.is_foreign:
            page = "another site" if sender.origin is None else _shown(sender.origin)
            return Problem(
                "foreign-origin",
                f"This service needs no API key, so it does not answer to pages of other sites. A page of {page} sent "
                "this.",
            )
        return None


async def _unless_keys_exist(problem: Problem, service: Service) -> Problem | None:
    """The problem of a service without keys, None of a service with keys, and another one if the store is away."""
    try:
        return None if await service.callers.keys_exist() else problem
    except Exception as error:
        fault = storage_problem(error)
        if fault is None:
            raise
        return fault


def _sender(scope: Scope) -> Sender:
    found = {_FIELDS[name]: str(value, "latin-1") for name, value in scope["headers"] if name in _FIELDS}
    local = cast("tuple[str, int | None] | None", scope.get("server"))
    return Sender(method=scope["method"], local=None if local is None else local[0], **found)


def _shown(text: str | None) -> str:
    return f"'{(text or '')[:_MAX_SHOWN]}'"
