"""The server: a service on a port, in the foreground or in a thread."""

import gc
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

import uvicorn

from equimesh.compiling import Line, announcing, is_live
from equimesh_service.api.app import create_app
from equimesh_service.errors import NotStartedError
from equimesh_service.files.folder import withhold_files
from equimesh_service.service import Service, check_cluster, check_database, check_files, check_folder
from equimesh_service.settings import Settings, describe_unknown, find_unknown
from equimesh_service.telemetry import logs
from equimesh_service.upkeep.exposure import check_exposure
from equimesh_service.wire.headers import MAX_HEAD_BYTES

_log = logging.getLogger(__name__)
# Times between two looks at a service that starts, between two changes of its line, and between two lines of its log.
_LOOK_SECONDS, _LINE_SECONDS, _LOG_SECONDS = 0.02, 0.5, 10.0
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


class _Start:
    """The start of a server: says how far it is in the log and in a ``line``, and where it listens in a ``sentence``.

    Whoever runs the server sets ``is_over`` when it has ended.
    """

    def __init__(self, server: _Server, sentence: str = "", *, line: Line | None = None) -> None:
        self.is_over = threading.Event()
        self._state = server.config.app.state  # type: ignore[union-attr]
        self._server, self._sentence, self._line = server, sentence, line or Line()
        self._began = self._shown = self._logged = time.monotonic()

    def wait(self) -> None:
        """Wait until the service can work; raises :class:`NotStartedError` when it cannot start."""
        try:
            while not self._look():
                if self.is_over.wait(_LOOK_SECONDS):
                    fault = getattr(self._state, "fault", "its log says why")
                    raise NotStartedError(f"the service did not start: {fault}")
                if self._service is not None and self._service.fault:
                    raise NotStartedError(f"the service did not start: {self._service.fault}")
        finally:
            self._line.clear()
        _log.info("ready after %.1f s", time.monotonic() - self._began)

    def follow(self) -> None:
        """As :meth:`wait`, for a server that tries again for ever; the engine logs why workers cannot start."""
        is_ready = False
        while not is_ready and not self.is_over.is_set():
            with suppress(NotStartedError):
                self.wait()
                is_ready = True
            self.is_over.wait(0.0 if is_ready else _LINE_SECONDS)

    @property
    def _service(self) -> Service | None:
        return getattr(self._state, "service", None)

    def _look(self) -> bool:
        """Whether the service is ready; says where it listens, and how far it is."""
        if not self._server.started or self._service is None:
            return False
        if self._sentence:
            print(self._sentence, file=sys.stderr, flush=True)
            self._sentence = ""
        if self._service.is_ready:
            return True
        if time.monotonic() - self._shown > _LINE_SECONDS:
            self._show(self._service.readiness.warm_up())
            self._shown = time.monotonic()
        return False

    def _show(self, warm_up: Mapping[str, int] | None) -> None:
        if not warm_up or not warm_up["of"]:
            return
        self._line.show(warm_up["compiled"], warm_up["of"])
        if time.monotonic() - self._logged > _LOG_SECONDS:
            _log.info("compiling the numerical loops: %(compiled)d of %(of)d", warm_up)
            self._logged = time.monotonic()


def run(settings: Settings) -> None:
    """Serve until the process gets SIGINT or SIGTERM; other users of the machine cannot read its files.

    Raises :class:`~equimesh_service.errors.FolderInUseError` when another service uses the data folder,
    :class:`~equimesh_service.errors.UnusableDatabaseError` when the database cannot be used,
    :class:`~equimesh_service.errors.ExposedError` when other machines could use the service without a key, and OSError
    when the address cannot be used.
    """
    withhold_files()
    at_terminal = is_live()
    if at_terminal and "log_level" not in settings.model_fields_set:
        settings = settings.model_copy(update={"log_level": "warning"})  # the address is not lost among log lines
    logs.configure(settings.log_level, settings.log_format)
    for name, nearest in find_unknown(os.environ).items():
        _log.warning("%s", describe_unknown(name, nearest))
    with _exit_cleanly(), announcing(None):
        server = _server(settings)
        gc.freeze()  # modules and routes stay: to look through them takes as long as a few requests
        gc.enable()
        listener = _open(settings)
        url = _url(settings, listener)
        _log.info("listening on %s", url)
        sentence = f"equimesh is at {url} - open this address in a browser. Ctrl-C stops the service."
        start = _Start(server, sentence if at_terminal else "")
        threading.Thread(target=start.follow, name="equimesh-start", daemon=True).start()
        try:
            server.run(sockets=[listener])
        finally:
            start.is_over.set()


@contextmanager
def running(settings: Settings, *, line: Line | None = None) -> Iterator[str]:
    """A service in a thread of this process, ready to work, for the length of a ``with``; gives its URL.

    While its workers compile their loops, ``line`` shows how far they are; by default at a terminal and in a notebook.
    Worker processes do not import the main module of the program, so a script needs no guard. Raises as :func:`run`,
    and :class:`~equimesh_service.errors.NotStartedError` when the service cannot start. As long as nothing fails it is
    waited for, however long the compiler takes.
    """
    server = _server(settings)
    listener = _open(settings)
    start = _Start(server, line=line)

    def serve() -> None:
        try:
            server.run(sockets=[listener])
        finally:
            start.is_over.set()

    thread = threading.Thread(target=serve, name="equimesh-server", daemon=True)
    thread.start()
    try:
        start.wait()
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
