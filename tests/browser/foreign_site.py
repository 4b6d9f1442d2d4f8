"""Another site: it serves one page to a browser, and passes all other requests on to the service.

To the service, that is a page whose host resolves to the service's address (DNS rebinding). With ``trusted`` the
requests lose what browsers say of them, so that the service takes them for those of a program.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

PAGE = Path(__file__).with_name("foreign_page.html").read_text()
# Headers by which a browser says which page sends a request.
TELLING = {"host", "origin", "referer"}


class Handler(BaseHTTPRequestHandler):
    """Answers one request; ``plan`` is what the page does."""

    plan: dict[str, Any]
    service: str
    trusted: bool

    def answer(self) -> None:
        if self.path == "/page":
            self._send(200, {"Content-Type": "text/html"}, PAGE.replace("PLAN", json.dumps(self.plan)).encode())
            return
        place = urlsplit(self.service)
        headers = {name: value for name, value in self.headers.items() if not (self.trusted and is_telling(name))}
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        wire = HTTPConnection(str(place.hostname), place.port, timeout=600.0)
        try:
            wire.request(self.command, self.path, body, headers)
            found = wire.getresponse()
            self._send(found.status, dict(found.getheaders()), found.read())
        finally:
            wire.close()

    do_GET = do_POST = do_PUT = do_PATCH = do_DELETE = do_OPTIONS = answer

    def log_message(self, format: str, *values: Any) -> None:
        pass

    def _send(self, status: int, headers: dict[str, str], body: bytes) -> None:
        self.send_response(status)
        for name, value in headers.items():
            if name.lower() not in {"content-length", "connection", "transfer-encoding"}:
                self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


def is_telling(name: str) -> bool:
    return name.lower() in TELLING or name.lower().startswith("sec-fetch-")


@contextmanager
def foreign_site(
    plan: dict[str, Any], service: str, *, address: str = "127.0.0.1", port: int = 0, trusted: bool = False
) -> Iterator[int]:
    """Serve the page at ``/page``; gives the port."""
    handler = type("Site", (Handler,), {"plan": plan, "service": service, "trusted": trusted})
    server = ThreadingHTTPServer((address, port), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
