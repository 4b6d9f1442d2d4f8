"""A service as a process that logs JSON and sends its traces to a receiver of OTLP in this process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest


@dataclass(frozen=True)
class Span:
    """A received span."""

    name: str
    trace: str
    id: str
    parent: str
    part: str
    pid: int
    start: int
    end: int
    failed: bool
    told: dict[str, Any]


@dataclass
class Observed:
    """The running service: its address and process, its log so far, the received spans."""

    log: Path
    url: str = ""
    pid: int = 0
    spans: list[Span] = field(default_factory=list)

    def lines(self, **fields: Any) -> list[dict[str, Any]]:
        """All lines of the log with these fields; every line is a JSON object."""
        found = [json.loads(line) for line in self.log.read_text().splitlines()]
        return [line for line in found if fields.items() <= line.items()]

    def trace(self, trace: str) -> dict[str, Span]:
        """The spans of a trace, by name."""
        return {span.name: span for span in self.spans if span.trace == trace}


@contextmanager
def observe(folder: Path) -> Iterator[Observed]:
    """A service with one worker."""
    service = Observed(folder / "log.jsonl")
    receiver = _receiver(service.spans)
    threading.Thread(target=receiver.serve_forever, daemon=True).start()
    settings = {
        "PORT": "0",
        "WORKERS": "1",
        "DATA_DIR": str(folder / "data"),
        "LOG_FORMAT": "json",
        "TRACE_ENDPOINT": f"http://127.0.0.1:{receiver.server_port}/v1/traces",
    }
    environment = {**os.environ, **{f"EQUIMESH_{name}": value for name, value in settings.items()}}
    with service.log.open("w") as log:
        process = subprocess.Popen([Path(sys.executable).parent / "equimesh", "serve"], env=environment, stderr=log)
    service.pid = process.pid
    try:
        service.url = _until(lambda: _address(service), 300.0)
        _until(lambda: _ready(service.url), 300.0)
        yield service
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(120.0)
        finally:
            process.kill()
            process.wait()
            receiver.shutdown()
            receiver.server_close()


def _until(condition: Callable[[], Any], seconds: float) -> Any:
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, "the service does not start"
        time.sleep(0.05)
    return value


def _address(service: Observed) -> str:
    text = service.log.read_text()
    whole = text[: text.rfind("\n") + 1].splitlines()
    said = [message for line in whole if (message := json.loads(line)["message"]).startswith("listening on ")]
    return said[0].removeprefix("listening on ") if said else ""


def _ready(url: str) -> bool:
    try:
        return httpx.get(f"{url}/readyz").status_code == 200
    except httpx.TransportError:
        return False


def _receiver(spans: list[Span]) -> ThreadingHTTPServer:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            spans.extend(_spans(ExportTraceServiceRequest.FromString(body)))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *arguments: Any) -> None:
            """Nothing."""

    return ThreadingHTTPServer(("127.0.0.1", 0), Handler)


def _spans(request: ExportTraceServiceRequest) -> Iterator[Span]:
    for resource in request.resource_spans:
        told = _told(resource.resource.attributes)
        for scope in resource.scope_spans:
            for span in scope.spans:
                yield Span(
                    name=span.name,
                    trace=span.trace_id.hex(),
                    id=span.span_id.hex(),
                    parent=span.parent_span_id.hex(),
                    part=told["equimesh.part"],
                    pid=told["process.pid"],
                    start=span.start_time_unix_nano,
                    end=span.end_time_unix_nano,
                    failed=span.status.code == 2,
                    told=_told(span.attributes),
                )


def _told(attributes: Any) -> dict[str, Any]:
    return {pair.key: getattr(pair.value, pair.value.WhichOneof("value")) for pair in attributes}
