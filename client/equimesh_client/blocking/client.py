"""The blocking client. Its twin for asyncio is in ``async_client``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any

from equimesh_client.blocking.mesh import Mesh
from equimesh_client.blocking.sequence import Sequences
from equimesh_client.errors import DeadlineExceeded
from equimesh_client.progress_bar import Watch
from equimesh_client.spec.domains import Domain, domain_json
from equimesh_client.spec.monitors import Monitor
from equimesh_client.spec.request import DEADLINE, Wish, order_of_spec, stored
from equimesh_client.spec.schwarz import Schwarz
from equimesh_client.spec.sources import StoredSamples
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.deadline import URL, Deadline, Settings
from equimesh_client.wire.key import with_key
from equimesh_client.wire.outcome import settled
from equimesh_client.wire.retry import RetryPolicy, policy_of
from equimesh_client.wire.session import Session
from equimesh_client.wire.transport import base_url


class Client:
    """A service of adaptive meshes; a context manager.

    ``timeout``: seconds that a single answer may take. ``retries``: further attempts after a lost
    connection, 429, 502, 503 or 504, or a :class:`RetryPolicy`. ``key``: the API key, that of the environment variable
    EQUIMESH_KEY unless given, ``""`` for none. ``headers``: sent with every request.

    Whatever waits for the service takes a ``deadline`` in seconds, after which it raises :class:`DeadlineExceeded`;
    unless given it is ``timeout`` for each attempt.
    """

    def __init__(
        self,
        url: str = URL,
        *,
        timeout: float = 30.0,
        retries: int | RetryPolicy = 5,
        key: str | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        settings = Settings(url=base_url(url), timeout=timeout, policy=policy_of(retries))
        self._session = Session(settings, with_key(headers, key))
        self.meshes = Meshes(self._session)
        self.samples = SamplesStore(self._session)
        self.sequences = Sequences(self._session)

    @property
    def url(self) -> str:
        """The address of the service."""
        return self._session.settings.url

    def generate(
        self,
        u: object = None,
        n: int | tuple[int, int] = 64,
        *,
        monitor: Monitor | Mapping[str, Any] | None = None,
        domain: Domain | Mapping[str, Any] | None = None,
        a: float = 0.7,
        b: float = 0.05,
        schwarz: Schwarz | Mapping[str, Any] | None = None,
        boundary: str = "trace",
        initial: str = "nested",
        mode: str = "discretization",
        allow_relaxed: bool = True,
        cells: str = "quad",
        label: str | None = None,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        n_samples: int = 129,
        reuse: bool = True,
        deadline: float = DEADLINE,
        progress: bool | None = None,
    ) -> Mesh:
        """The finished mesh of ``n`` points a side (or ``(n_xi, n_eta)``) that is adapted to ``u``.

        ``u`` is an expression in x and y; a 2-D array of values on the uniform grid of the domain's box,
        first index along x; ``(x, y, values)``; scattered ``(points, values)``; a callable ``u(x, y)`` on
        arrays, sampled here on ``n_samples`` points a side; a ``pathlib.Path`` of a file of samples; or
        stored samples. ``monitor`` says what is equidistributed: :class:`ArcLength` of u unless given, with
        ``a`` and ``b``; :class:`Weight` and :class:`Tensor` need no u. ``domain``: the unit square unless given.
        ``parameters`` and ``t`` go with all expressions. ``schwarz=None`` solves on a single domain.

        ``mode="tight"`` solves the equations to rounding, not just to the error of the grid. Where they cannot be
        solved as asked the mesh is for a weaker monitor, ``mesh.relaxed``; ``allow_relaxed=False`` fails instead.
        With ``reuse`` the service may answer at once with a mesh of the same request that it has, which
        ``mesh.reused_from`` names. ``progress``: a bar, True, False, or None: on a terminal.

        When the deadline (seconds) passes or the wait is interrupted, the mesh is canceled. Raises
        :class:`MeshFailed`, :class:`InvalidInput` and the rest of the tree in ``errors``.
        """
        limit = Deadline.after(deadline)
        wish = Wish(
            u=u,
            n=n,
            monitor=monitor,
            domain=domain,
            a=a,
            b=b,
            schwarz=schwarz,
            boundary=boundary,
            initial=initial,
            mode=mode,
            allow_relaxed=allow_relaxed,
            cells=cells,
            label=label,
            parameters=parameters,
            t=t,
            n_samples=n_samples,
            reuse=reuse,
        )
        mesh = None
        settings = self._session.settings
        made = self._session.run(flows.prepared(wish, settings, limit))
        try:
            with Watch(progress) as watch:
                hold = max(1, min(1 if watch.shown else flows.LONG_POLL, int(limit.left)))
                flow = flows.create(made, settings, wait=hold, deadline=limit)
                mesh = Mesh(self._session, self._session.run(flow))
                mesh._wait(limit, watch)
        except (DeadlineExceeded, KeyboardInterrupt):
            self._session.run(flows.abandon(made, mesh.id if mesh else None, settings))
            raise
        settled(mesh)
        return mesh

    def check(
        self,
        expression: str,
        *,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        domain: Domain | Mapping[str, Any] | None = None,
        deadline: float | None = None,
    ) -> dict[str, Any]:
        """What the service finds in an expression on ``domain``, the unit square unless given; raises
        :class:`InvalidInput` with the position of a fault.
        """
        where = None if domain is None else domain_json(domain)
        call = protocol.check_expression(expression, parameters, t, where)
        return self._session.fetch(call, deadline)

    def capabilities(self, *, deadline: float | None = None) -> dict[str, Any]:
        """Formats, limits, functions and transmission conditions of the service."""
        return self._session.fetch(protocol.capabilities(), deadline)

    def close(self) -> None:
        """Close all connections."""
        self._session.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Meshes:
    """The meshes of a service: ``client.meshes``."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def create(
        self,
        spec: Mapping[str, Any],
        *,
        samples: object = None,
        idempotency_key: str | None = None,
        reuse: bool = True,
        wait: int = 0,
        deadline: float | None = None,
    ) -> Mesh:
        """The mesh that is asked for by a whole spec of the HTTP interface; does not wait for it to be
        finished, but for ``wait`` seconds. ``samples`` are uploaded for ``{"samples": "upload"}`` in its monitor.
        The same ``idempotency_key`` gives the same mesh, however often it is sent.
        """
        made = order_of_spec(spec, samples, idempotency_key, reuse=reuse)
        settings = self._session.settings
        limit = settings.deadline(settings.attempts + wait if deadline is None else deadline)
        flow = flows.create(made, settings, wait=wait, deadline=limit)
        return Mesh(self._session, self._session.run(flow))

    def get(self, mesh_id: str, *, deadline: float | None = None) -> Mesh:
        """The mesh of that id; raises :class:`NotFound`."""
        record = self._session.fetch(protocol.get_mesh(mesh_id), deadline)
        return Mesh(self._session, record)

    def list(
        self,
        *,
        status: str | None = None,
        label: str | None = None,
        limit: int | None = None,
        deadline: float | None = None,
    ) -> Iterator[Mesh]:
        """The meshes, newest first, at most ``limit``; fetched page by page as they are iterated over;
        the deadline is that of a page.
        """
        left, cursor = limit, None
        while left is None or left > 0:
            size = 100 if left is None else min(left, 100)
            limited = self._session.settings.deadline(deadline)
            page = flows.pages(self._session.settings, limited, status=status, label=label, cursor=cursor, limit=size)
            items, cursor = self._session.run(page)
            items = items[:left]
            for item in items:
                yield Mesh(self._session, item)
            left = None if left is None else left - len(items)
            if cursor is None:
                return


class SamplesStore:
    """The samples that a service keeps: ``client.samples``."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def upload(
        self,
        u: object,
        *,
        n_samples: int = 129,
        domain: Domain | Mapping[str, Any] | None = None,
        deadline: float | None = None,
    ) -> StoredSamples:
        """Samples stored once, for any number of meshes: arrays, a callable, or a ``pathlib.Path`` of a
        file. A callable, or an array of values alone, is taken on the box of ``domain``, the unit square unless given.
        """
        settings = self._session.settings
        flow = flows.upload(u, n_samples, domain, settings, settings.deadline(deadline))
        return stored(self._session.run(flow))

    def get(self, samples_id: str, *, deadline: float | None = None) -> StoredSamples:
        """The stored samples of that id."""
        return stored(self._session.fetch(protocol.stored_samples(samples_id), deadline))

    def delete(self, samples: str | StoredSamples, *, deadline: float | None = None) -> None:
        """Delete stored samples."""
        name = samples if isinstance(samples, str) else samples.id
        call = protocol.stored_samples(name, method="DELETE")
        settings = self._session.settings
        self._session.run(flows.delete(call, settings, settings.deadline(deadline)))
