"""Headers of every answer: the rules for browsers, and those that the work on a request adds."""

from collections.abc import Mapping

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_EXTRA = "equimesh.headers"

# Answers for programs: browsers may not run, load or frame anything in them.
_NOTHING = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
# Pictures by matplotlib, with styles on every line, and images inside where there are many cells.
_PICTURE = f"{_NOTHING}; style-src 'unsafe-inline'; img-src data:; sandbox"
_ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
_POLICY = "Content-Security-Policy"


class SecurityHeaders:
    """An ASGI application with the headers on all its answers; bodies are not touched."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        extra: dict[str, str] = {}
        scope[_EXTRA] = extra

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                _complete(MutableHeaders(scope=message), extra)
            await send(message)

        await self._app(scope, receive, send_with_headers)


def add_headers(request: Request, headers: Mapping[str, str]) -> None:
    """Add headers to the answer of a request, whatever it will be."""
    request.scope.setdefault(_EXTRA, {}).update(headers)


def page_policy(*, pictures: str) -> str:
    """The policy of a page for people: its scripts, styles and requests are those of this service."""
    return f"{_NOTHING}; script-src 'self'; style-src 'self'; img-src {pictures}; font-src 'self'; connect-src 'self'"


def _complete(headers: MutableHeaders, extra: Mapping[str, str]) -> None:
    for name, value in _ALWAYS.items():
        headers.setdefault(name, value)
    if _POLICY not in headers:
        headers[_POLICY] = _PICTURE if headers.get("content-type", "").startswith("image/svg") else _NOTHING
    headers.setdefault("Cache-Control", "no-store")
    for name, value in extra.items():
        headers.setdefault(name, value)
