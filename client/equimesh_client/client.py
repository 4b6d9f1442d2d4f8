"""The clients, blocking and for asyncio, with one definition of what they do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from asyncio import CancelledError
from collections.abc import AsyncIterator, Mapping
from inspect import isawaitable
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, Unpack

from equimesh_client.errors import DeadlineExceeded
from equimesh_client.mesh import AsyncMesh, M, Mesh
from equimesh_client.operation import Awaiting, Blocking, operation
from equimesh_client.progress_bar import Watch
from equimesh_client.sequence import AsyncSequences, Sequences
from equimesh_client.spec.domains import Domain, domain_json
from equimesh_client.spec.request import GenerateArguments, MeshOptions, complete_options, request_of_spec
from equimesh_client.spec.sources import StoredSamples, read_mesh_file
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.adapting import AdaptLoop, Observe, Solve
from equimesh_client.wire.arrays import MeshArrays, raise_unless_succeeded
from equimesh_client.wire.downloads import unpacking, write_atomically
from equimesh_client.wire.protocol import Pages
from equimesh_client.wire.settings import (
    DEADLINE_SECONDS,
    DEFAULT_URL,
    Deadline,
    RetryPolicy,
    Settings,
    headers_with_key,
    policy_of,
)
from equimesh_client.wire.transport import Session, Transport, base_url
from equimesh_coupling.adaptation import Adaptation
from equimesh_coupling.goals import Goal
from equimesh_schema import Certificate
from equimesh_schema.document import hinted
from equimesh_schema.monitors import Norm


class ClientOperations(ABC, Generic[M]):
    """What either client does."""

    _mesh: type[M]
    _transport: ClassVar[type[Transport]]

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        timeout: float = 30.0,
        retries: int | RetryPolicy = 5,
        key: str | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        settings = Settings(url=base_url(url), timeout=timeout, policy=policy_of(retries))
        self._session = Session(settings, self._transport(settings.url, headers_with_key(headers, key)))

    @property
    def url(self) -> str:
        """The address of the service."""
        return self._session.settings.url

    @operation
    async def generate(
        self,
        u: object = None,
        n: int | tuple[int, int] = 64,
        *,
        initial: str = "nested",
        cells: str = "quad",
        reuse: bool = True,
        deadline: float = DEADLINE_SECONDS,
        progress: bool | None = None,
        **options: Unpack[MeshOptions],
    ) -> M:
        """The finished mesh of ``n`` points a side (or ``(n_xi, n_eta)``) that is adapted to ``u``.

        ``u`` is an expression in x and y; a 2-D array of values on the uniform grid of the domain's box, first index
        along x; ``(x, y, values)``; scattered ``(points, values)``; a callable ``u(x, y)`` on arrays; a
        ``pathlib.Path`` of a file of samples; or stored samples. :class:`Weight` and :class:`Tensor` need no u.

        ``options`` are those of :class:`MeshOptions`. ``initial`` is the first mesh, ``"nested"`` or ``"uniform"``.
        ``cells`` of files and arrays are ``"quad"`` or ``"triangle"``. With ``reuse`` the service may answer with an
        earlier mesh of the same request, which ``mesh.reused_from`` names. ``progress`` shows a bar; None shows it on
        a terminal and in a notebook.

        When the deadline (seconds) passes, or the wait is interrupted or its task canceled, the mesh is canceled.
        Raises :class:`MeshFailed`, :class:`InvalidInput` and the rest of the tree in ``errors``.
        """
        complete = complete_options(options, type(self).generate)
        arguments = GenerateArguments(u=u, n=n, options=complete, initial=initial, cells=cells, reuse=reuse)
        return await self._generate(arguments, deadline, progress)

    async def _generate(self, arguments: GenerateArguments, deadline: float, progress: bool | None) -> M:
        limit, settings = Deadline.after(deadline), self._session.settings
        request = await self._session.run(flows.prepare(arguments, settings, limit))
        mesh = None
        try:
            with Watch(progress) as watch:
                hold = flows.hold_seconds(limit, watched=watch.shown)
                flow = flows.create(request, settings, wait=hold, deadline=limit)
                mesh = self._mesh(self._session, await self._session.run(flow))
                await mesh._wait(limit, watch)
                raise_unless_succeeded(mesh)
        except (DeadlineExceeded, KeyboardInterrupt, CancelledError):
            await self._session.run(flows.abandon(request, mesh.id if mesh else None, settings))
            raise
        return mesh

    @operation
    async def compute(
        self,
        u: object = None,
        n: int | tuple[int, int] = 64,
        *,
        initial: str = "nested",
        cells: str = "quad",
        deadline: float = DEADLINE_SECONDS,
        **options: Unpack[MeshOptions],
    ) -> MeshArrays:
        """The arrays of the mesh that :meth:`generate` would give, of which the service keeps nothing.

        For small meshes in a loop: one request and no commit. It takes the arguments of :meth:`generate`, and the
        answer has a ``certificate``. The service computes at most EQUIMESH_MAX_WAIT seconds, and refuses a mesh in
        parts. Raises :class:`ProblemError` for a solve that failed, and the rest of the tree in ``errors``.
        """
        complete = complete_options(options, type(self).generate)
        arguments = GenerateArguments(u=u, n=n, options=complete, initial=initial, cells=cells)
        limit, settings = Deadline.after(deadline), self._session.settings
        request = await self._session.run(flows.prepare(arguments, settings, limit))
        return await self._session.run(flows.compute(request, settings, limit))

    @operation
    async def compute_file(
        self,
        path: str | Path,
        u: object = None,
        n: int | tuple[int, int] = 64,
        *,
        initial: str = "nested",
        cells: str = "quad",
        deadline: float = DEADLINE_SECONDS,
        **options: Unpack[MeshOptions],
    ) -> Certificate | None:
        """The certificate of a mesh of which only the file at ``path`` is kept, in the format of its suffix.

        An ``.xdmf`` comes with the files that it refers to, and a folder that exists is a case, as in ``download``.
        Takes and raises the same as :meth:`compute`, and :class:`BadArgument` where the file cannot be written.
        """
        complete = complete_options(options, type(self).generate)
        arguments = GenerateArguments(u=u, n=n, options=complete, initial=initial, cells=cells)
        limit, settings, format = Deadline.after(deadline), self._session.settings, protocol.format_of(str(path))
        request = await self._session.run(flows.prepare(arguments, settings, limit))
        content, certificate = await self._session.run(flows.compute_file(request, format, settings, limit))
        unpack = unpacking(path)
        if unpack is None:
            write_atomically(path, content)
        else:
            unpack(content, path)
        return certificate

    @operation
    @hinted(max_points="did you mean 'points'?")
    async def adapt(
        self,
        solve: Solve,
        n: int | tuple[int, int] | None = None,
        *,
        domain: Domain | Mapping[str, Any] | None = None,
        points: int | None = None,
        rounds: int = 5,
        norm: Norm | None = None,
        degree: int | None = None,
        cells: Literal["quad", "triangle"] | None = None,
        goal: Goal | None = None,
        tolerance: float | None = None,
        observe: Observe | None = None,
        deadline: float = DEADLINE_SECONDS,
    ) -> Adaptation[M]:
        """The mesh of ``n`` points a side, or ``(n_xi, n_eta)``, that is adapted to the solution of a solver.

        ``points`` in place of ``n`` is the number of points of the whole mesh, at most: once a round resolves the
        solution, the service chooses how many lie along xi and eta, on blocks along opposite edges. On a domain of
        blocks ``n`` is left out: without ``points`` the mesh has their cells. An ``ErrorIndicator`` is refused there.

        ``solve(mesh)`` solves on a :class:`Mesh`, which has the methods ``to_skfem()``, ``to_dolfinx(comm)`` and so
        on, and returns one of these: values at the nodes, a field of a library with an adaptor, ``CellAverages``, or
        an ``ErrorIndicator`` of the cells. It is called first on the uniform mesh, on blocks the initial one, then at
        most ``rounds`` times. ``norm`` is that of the error that meshes minimise and by which rounds are ranked,
        ``"l2"``, without a goal the default, or ``"h1"``. ``degree``, 1 to 4, is that of the elements at whose nodes
        values are; without it that of a field whose space shows it is taken, and 1 for arrays. ``cells`` are those of
        the elements, and of all meshes; without it those of such a field, and quadrilaterals. ``observe`` is called
        with every round. ``deadline`` is that of each mesh, in seconds.

        With a ``goal`` meshes make the error of that functional small, ``solve`` returns :class:`WithAdjoint`, and the
        loop ends, too, where its estimated error and the change of its corrected value are at most ``tolerance``
        together, on two meshes that resolve u and z.

        With :class:`AsyncClient` it gets the arrays of the mesh, whose ``to_skfem()`` and other methods need no await,
        and returns its solution or an awaitable of it.

        Raises ``BadValues`` where the values of the first solve cannot be used, and what the first solve raises. Later
        the loop ends with the best mesh so far: ``reason`` says why, ``failure`` is the exception. Raises
        :class:`BadArgument` for arguments that cannot be used.
        """
        loop: AdaptLoop[M] = AdaptLoop(
            solve=solve,
            n=n,
            domain=domain,
            rounds=rounds,
            norm=norm,
            degree=degree,
            cells=cells,
            goal=goal,
            tolerance=tolerance,
            points=points,
        )
        settings = self._session.settings
        loop.domain = await self._session.run(flows.stored_domain(domain, settings, Deadline.after(deadline)))
        mesh = await self._generate(loop.first(), deadline, False)
        while True:
            try:
                arrays = await mesh._fetched(deadline)
                answered = loop.receive(arrays, await self._solved(solve, mesh, arrays))
                request = loop.next(answered)
                after = None if request is None else await self._generate(request, deadline, False)
                moved = None if after is None else await after._fetched(deadline)
            except Exception as failure:
                if not loop.done:
                    raise
                return loop.ended(failure)
            loop.add(mesh, answered, None if after is None else after.certificate, moved)
            if observe is not None:
                observe(loop.done[-1])
            if after is None or loop.is_done:
                return loop.ended()
            mesh = after

    @operation
    async def check(
        self,
        expression: str,
        *,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        domain: Domain | Mapping[str, Any] | None = None,
        deadline: float | None = None,
    ) -> dict[str, Any]:
        """The service's report on an expression on ``domain``, by default the unit square.

        Raises :class:`InvalidInput` with the position of a fault.
        """
        domain = None if domain is None else domain_json(domain)
        return await self._session.fetch(protocol.check_expression(expression, parameters, t, domain), deadline)

    @operation
    async def capabilities(self, *, deadline: float | None = None) -> dict[str, Any]:
        """Formats, limits, functions and transmission conditions of the service."""
        return await self._session.fetch(protocol.capabilities(), deadline)

    @operation
    async def close(self) -> None:
        """Close all connections."""
        await self._session.close()

    @abstractmethod
    async def _solved(self, solve: Solve, mesh: M, arrays: MeshArrays) -> object:
        """What the solver returns on a mesh with these arrays."""


class MeshesOperations(Generic[M]):
    """What the meshes of either client do."""

    _mesh: type[M]

    def __init__(self, session: Session) -> None:
        self._session = session

    @operation
    async def create(
        self,
        spec: Mapping[str, Any],
        *,
        samples: object = None,
        idempotency_key: str | None = None,
        reuse: bool = True,
        wait: int = 0,
        deadline: float | None = None,
    ) -> M:
        """A new mesh, from a complete spec of the HTTP interface; returns before it is finished.

        The service holds its answer back for up to ``wait`` seconds, until the mesh is finished. ``samples`` are
        uploaded for ``{"samples": "upload"}`` in the monitor. The same ``idempotency_key`` gives the same mesh, however
        often it is sent.
        """
        request, settings = request_of_spec(spec, samples, idempotency_key, reuse=reuse), self._session.settings
        limit = settings.deadline(settings.attempts + wait if deadline is None else deadline)
        flow = flows.create(request, settings, wait=wait, deadline=limit)
        return self._mesh(self._session, await self._session.run(flow))

    @operation
    async def get(self, mesh_id: str, *, deadline: float | None = None) -> M:
        """The mesh of that id; raises :class:`NotFound`."""
        return self._mesh(self._session, await self._session.fetch(protocol.get_mesh(mesh_id), deadline))

    @operation
    async def list(
        self,
        *,
        status: str | None = None,
        label: str | None = None,
        limit: int | None = None,
        deadline: float | None = None,
    ) -> AsyncIterator[M]:
        """The meshes, newest first, at most ``limit``; fetched page by page, each within ``deadline``."""
        pages = Pages(status=status, label=label, limit=limit)
        while pages.more:
            page = await self._session.fetch(pages.next_call(), deadline)
            for record in pages.records(page):
                yield self._mesh(self._session, record)


class SamplesOperations:
    """What the stored samples of either client do."""

    def __init__(self, session: Session) -> None:
        self._session = session

    @operation
    async def upload(
        self,
        u: object,
        *,
        n_samples: int = 129,
        domain: Domain | Mapping[str, Any] | None = None,
        deadline: float | None = None,
    ) -> StoredSamples:
        """Samples stored once, for any number of meshes: arrays, a callable, or a ``pathlib.Path`` of a file.

        A callable, or an array of values alone, lies on the box of ``domain``, by default the unit square.
        """
        settings = self._session.settings
        flow = flows.upload(u, n_samples, domain, settings, settings.deadline(deadline))
        return StoredSamples.from_json(await self._session.run(flow))

    @operation
    async def upload_mesh(self, path: str | Path, *, deadline: float | None = None) -> StoredSamples:
        """A mesh file stored once; ``MeshFile(file=stored.id)`` is then the domain of any number of meshes."""
        call = protocol.upload_mesh(read_mesh_file(path))
        return StoredSamples.from_json(await self._session.fetch(call, deadline))

    @operation
    async def get(self, samples_id: str, *, deadline: float | None = None) -> StoredSamples:
        """The stored samples of that id."""
        return StoredSamples.from_json(await self._session.fetch(protocol.stored_samples(samples_id), deadline))

    @operation
    async def delete(self, samples: str | StoredSamples, *, deadline: float | None = None) -> None:
        """Delete stored samples."""
        samples_id = samples if isinstance(samples, str) else samples.id
        await self._session.delete(protocol.stored_samples(samples_id, method="DELETE"), deadline)


class Meshes(Blocking, MeshesOperations[Mesh]):
    """The meshes of a service: ``client.meshes``."""

    _mesh = Mesh


class SamplesStore(Blocking, SamplesOperations):
    """The stored samples of a service: ``client.samples``."""


class Client(Blocking, ClientOperations[Mesh]):
    """A service of adaptive meshes; a context manager.

    ``timeout``: seconds that a single answer may take. ``retries``: further attempts after a lost connection, 429,
    502, 503 or 504, or a :class:`RetryPolicy`. ``key``: the API key; by default that of the environment variable
    EQUIMESH_KEY, ``""`` for none. ``headers``: sent with every request.

    Every method that waits for the service takes a ``deadline`` in seconds, after which it raises
    :class:`DeadlineExceeded`. A default of None allows all attempts of ``timeout`` seconds.
    """

    _mesh = Mesh

    @property
    def meshes(self) -> Meshes:
        """The meshes of the service."""
        return Meshes(self._session)

    @property
    def samples(self) -> SamplesStore:
        """The stored samples of the service."""
        return SamplesStore(self._session)

    @property
    def sequences(self) -> Sequences:
        """The sequences of the service."""
        return Sequences(self._session)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    async def _solved(self, solve: Solve, mesh: Mesh, arrays: MeshArrays) -> object:  # noqa: ARG002
        return solve(mesh)


class AsyncMeshes(Awaiting, MeshesOperations[AsyncMesh]):
    """The meshes of a service, for asyncio: ``client.meshes``."""

    _mesh = AsyncMesh


class AsyncSamplesStore(Awaiting, SamplesOperations):
    """The stored samples of a service, for asyncio: ``client.samples``."""


class AsyncClient(Awaiting, ClientOperations[AsyncMesh]):
    """A service of adaptive meshes; an asynchronous context manager. Arguments are those of :class:`Client`.

    Every method does what the method of that name of :class:`Client` does, and raises the same exceptions.
    """

    _mesh = AsyncMesh

    @property
    def meshes(self) -> AsyncMeshes:
        """The meshes of the service."""
        return AsyncMeshes(self._session)

    @property
    def samples(self) -> AsyncSamplesStore:
        """The stored samples of the service."""
        return AsyncSamplesStore(self._session)

    @property
    def sequences(self) -> AsyncSequences:
        """The sequences of the service."""
        return AsyncSequences(self._session)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _solved(self, solve: Solve, mesh: AsyncMesh, arrays: MeshArrays) -> object:  # noqa: ARG002
        returned = solve(arrays)
        return await returned if isawaitable(returned) else returned
