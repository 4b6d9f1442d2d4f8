"""The limit of a request's head: its line and its headers.

The server stops reading a head that is longer and not complete yet. One that comes in a single piece is complete when
the server sees it, and is refused here.
"""

from starlette.types import ASGIApp, Receive, Scope, Send

from equimesh_service.problems.problem import Problem

# The most bytes of a request line and its headers.
MAX_HEAD_BYTES = 32 * 1024
# Bytes of a header line in addition to name and value: colon, space, line end.
_LINE_BYTES = 4


class HeaderLimit:
    """ASGI middleware that answers 431 to a request whose head is too long."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or _head_bytes(scope) <= MAX_HEAD_BYTES:
            await self._app(scope, receive, send)
            return
        detail = f"The request line and the headers may have at most {MAX_HEAD_BYTES} bytes together."
        problem = Problem("headers-too-large", detail, headers={"Connection": "close"})
        await problem.response()(scope, receive, send)


def _head_bytes(scope: Scope) -> int:
    line = len(scope["method"]) + len(scope.get("raw_path") or scope["path"]) + len(scope["query_string"])
    return line + sum(len(name) + len(value) + _LINE_BYTES for name, value in scope["headers"])
