"""The server: a service on a port, in the foreground or in a thread."""

import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn

from equimesh_service.api.app import create_app
from equimesh_service.errors import NotStartedError
from equimesh_service.files.privacy import withhold_files
from equimesh_service.opening import check_cluster, check_database, check_files, check_folder
from equimesh_service.settings import Settings, describe_unknown, find_unknown
from equimesh_service.telemetry import logs
from equimesh_service.upkeep.exposure import check_exposure
from equimesh_service.wire.header_limit import MAX_HEAD_BYTES

_log = logging.getLogger(__name__)
# The first start on a machine compiles the kernels.
_MAX_START_SECONDS = 300.0
# Time that running requests have when the service stops.
_GRACE_SECONDS = 5
# Longer than proxies keep their connections (nginx: 60), so that none is closed while they use it.
_KEEP_ALIVE_SECONDS = 75


class _Server(uvicorn.Server):
    """A uvicorn server that ends waits and streams before it stops."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        service = getattr(self.config.app.state, "service", None)  # type: ignore[union-attr]
        if service is not None:
            service.wakeups.close()
        await super().shutdown(sockets)


def run(settings: Settings) -> None:
    """Serve until the process gets SIGINT or SIGTERM; other users of the machine cannot read its files.

    Raises :class:`~equimesh_service.errors.FolderInUseError` when another service uses the data folder,
    :class:`~equimesh_service.errors.UnusableDatabaseError` when the database cannot be used,
    :class:`~equimesh_service.errors.ExposedError` when other machines could use the service without a key, and OSError
    when the address cannot be used.
    """
    withhold_files()
    logs.configure(settings.log_level, settings.log_format)
    for name, nearest in find_unknown(os.environ).items():
        _log.warning("%s", describe_unknown(name, nearest))
    with _exit_cleanly():
        server = _server(settings)
        listener = _open(settings)
        _log.info("listening on %s", _url(settings, listener))
        server.run(sockets=[listener])


@contextmanager
def running(settings: Settings) -> Iterator[str]:
    """A service in a thread of this process, ready to work, for the length of a ``with``; gives its URL.

    Worker processes import the main module of the program: guard it by ``if __name__ == "__main__"``. Raises as
    :func:`run`, and :class:`~equimesh_service.errors.NotStartedError` when the service does not start.
    """
    server = _server(settings)
    listener = _open(settings)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="equimesh-server", daemon=True)
    thread.start()
    try:
        _wait_until_ready(server, thread)
        yield _url(settings, listener)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


@contextmanager
def _exit_cleanly() -> Iterator[None]:
    """Exit with 0 on SIGTERM: at once before the server runs, later when it has closed.

    The server sends itself the signal again at its end, which would count as a failure. The first process of a
    container gets no SIGTERM without a handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _server(settings: Settings) -> _Server:
    logging.getLogger("uvicorn.access").disabled = True  # ours says more, and leaves out what a client put into a path
    config = uvicorn.Config(
        create_app(settings),
        log_config=None,
        log_level=settings.log_level,
        access_log=False,
        timeout_graceful_shutdown=_GRACE_SECONDS,
        lifespan="on",
        server_header=False,
        proxy_headers=True,
        forwarded_allow_ips=settings.trusted_proxies,
        root_path=settings.root,
        timeout_keep_alive=_KEEP_ALIVE_SECONDS,
        h11_max_incomplete_event_size=MAX_HEAD_BYTES,
    )
    return _Server(config)


def _open(settings: Settings) -> socket.socket:
    """Take the address first: a service without an address leaves no files behind."""
    listener = _listen(settings)
    try:
        check_folder(settings)
        check_files(settings)
        check_database(settings)
        check_cluster(settings)
        check_exposure(settings)
    except BaseException:
        listener.close()
        raise
    return listener


def _listen(settings: Settings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # asyncio then sets TCP_NODELAY
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((settings.host, settings.port))
    except OSError:
        listener.close()
        raise
    return listener


def _url(settings: Settings, listener: socket.socket) -> str:
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(settings.host, settings.host)
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{listener.getsockname()[1]}"


def _wait_until_ready(server: _Server, thread: threading.Thread) -> None:
    deadline = time.monotonic() + _MAX_START_SECONDS
    while time.monotonic() < deadline and thread.is_alive():
        service = getattr(server.config.app.state, "service", None)  # type: ignore[union-attr]
        if server.started and service is not None and service.is_ready:
            return
        time.sleep(0.02)
    raise NotStartedError("the service did not start; its log says why")
