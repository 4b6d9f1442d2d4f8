"""The outermost layer of the application: an id, a log line, metrics and an optional span for every request."""

from __future__ import annotations

import logging
import re
import time
from contextlib import AbstractContextManager, ExitStack, nullcontext

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from equimesh_service.problems.problem import problem_of
from equimesh_service.telemetry import log_context, logs, stopwatch, tracing
from equimesh_service.telemetry.stopwatch import Stopwatch
from equimesh_service.telemetry.tracing import Tracer
from equimesh_service.upkeep.metrics import UNMATCHED, Metrics

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
