"""The outermost layers of the application: log lines and metrics, and the guard against pages of other sites."""

from __future__ import annotations

import logging
import re
import time
from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import cast

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from equimesh_service.problems.problem import Problem, problem_of
from equimesh_service.problems.storage import storage_problem
from equimesh_service.service import Service
from equimesh_service.settings import Settings
from equimesh_service.telemetry import log_context, logs, stopwatch, tracing
from equimesh_service.telemetry.stopwatch import Stopwatch
from equimesh_service.telemetry.tracing import Tracer
from equimesh_service.upkeep.metrics import UNMATCHED, Metrics
from equimesh_service.wire.headers import KnownHosts, Sender

REQUEST_ID = "X-Request-Id"
_ID_HEADER = REQUEST_ID.lower().encode()
_log = logging.getLogger(__name__)
_MESH = re.compile(r"/v1/meshes/(m-[0-9a-f]{1,38})(?:/|$)", re.ASCII)
# Routes that probes and Prometheus request often.
_UNLOGGED_ROUTES = frozenset({"/livez", "/readyz", "/metrics"})


class Observation:
    """ASGI middleware around all others; an exception that reaches it becomes a problem."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics, tracer: Tracer | None) -> None:
        self._app = app
        self._metrics = metrics
        self._tracer = tracer

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        named = _MESH.search(scope["path"])
        here = log_context.LogContext(
            request_id=log_context.choose_request_id(_header(scope, _ID_HEADER)),
            mesh_id="" if named is None else named[1],
        )
        with ExitStack() as stack:
            exchange = _Exchange(send, here.request_id, self._metrics, stack, stopwatch.start())
            with log_context.enter(here), self._span(scope):
                try:
                    await self._answer(scope, receive, exchange)
                finally:
                    self._record(scope, exchange, time.perf_counter() - began)

    async def _answer(self, scope: Scope, receive: Receive, exchange: _Exchange) -> None:
        try:
            await self._app(scope, receive, exchange.send)
        except Exception as error:
            problem = problem_of(error)
            _log.error("%s %s: %s", scope["method"], _route(scope), problem.name, exc_info=error)
            if exchange.status:
                raise  # part of the answer is sent: all that is left is to cut the connection
            await problem.response()(scope, receive, exchange.send)

    def _span(self, scope: Scope) -> AbstractContextManager[None]:
        if self._tracer is None:
            return nullcontext()
        tracing.use(self._tracer)
        method = scope["method"]
        parent = _header(scope, b"traceparent")
        return self._tracer.span(method, {"http.request.method": method}, parent=parent or "", serves=True)

    def _record(self, scope: Scope, exchange: _Exchange, seconds: float) -> None:
        method, route, status = scope["method"], _route(scope), exchange.status
        if self._tracer is not None:
            attributes: tracing.Attributes = {"http.route": route, "http.response.status_code": status}
            self._tracer.describe(f"{method} {route}", attributes, failed=status >= 500)
        if not status:
            return  # the client or the service left before the answer
        exchange.size = 0 if method == "HEAD" else exchange.size  # the server cuts the body off
        self._metrics.count_answer(method, route, status, seconds, exchange.size)
        if route not in _UNLOGGED_ROUTES:
            logs.access(method, route, status, seconds, exchange.size)


class _Exchange:
    """The answer that is being sent: its status and its size in bytes."""

    def __init__(self, send: Send, request_id: str, metrics: Metrics, stack: ExitStack, stopwatch: Stopwatch) -> None:
        self._send = send
        self._id = request_id.encode()
        self._metrics = metrics
        self._stack = stack
        self._stopwatch = stopwatch
        self.status = 0
        self.size = 0

    async def send(self, message: Message) -> None:
        """Forward a message, and count it."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers: list[tuple[bytes, bytes]] = [*message.get("headers", ()), (_ID_HEADER, self._id)]
            self._count_kind(headers)
            if self._stopwatch.laps:
                self._stopwatch.lap("answer")
                headers.append((b"server-timing", self._stopwatch.to_header().encode()))
            message = {**message, "headers": headers}
        elif message["type"] == "http.response.body":
            self.size += len(message.get("body", b""))
        await self._send(message)

    def _count_kind(self, headers: list[tuple[bytes, bytes]]) -> None:
        for name, value in headers:
            if name == b"content-type" and value.startswith(b"text/event-stream"):
                self._stack.enter_context(self._metrics.count_stream())
            elif name == b"equimesh-reused":
                self._metrics.count_reuse()


def _header(scope: Scope, name: bytes) -> str | None:
    for key, value in scope["headers"]:
        if key == name:
            return str(value, "latin-1")
    return None


def _route(scope: Scope) -> str:
    """The template of the path: as many values as there are routes, whatever clients request."""
    return getattr(scope.get("route"), "path", None) or UNMATCHED


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
