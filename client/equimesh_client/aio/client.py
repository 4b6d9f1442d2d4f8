"""The client for asyncio: the twin of ``equimesh_client.blocking.client``, with the same flows."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from inspect import isawaitable
from pathlib import Path
from typing import Any, Unpack

from equimesh_client.aio.mesh import AsyncMesh
from equimesh_client.aio.sequence import AsyncSequences
from equimesh_client.errors import DeadlineExceeded
from equimesh_client.progress_bar import Watch
from equimesh_client.spec.domains import Domain, domain_json
from equimesh_client.spec.mesh import MeshOptions, complete_options
from equimesh_client.spec.request import GenerateArguments, request_of_spec
from equimesh_client.spec.sources import StoredSamples, read_mesh_file
from equimesh_client.wire import flows, protocol
from equimesh_client.wire.adapting import AdaptLoop, Observe, Solve
from equimesh_client.wire.deadline import DEADLINE_SECONDS, DEFAULT_URL, Deadline, Settings
from equimesh_client.wire.key import headers_with_key
from equimesh_client.wire.outcome import raise_unless_succeeded
from equimesh_client.wire.pages import Pages
from equimesh_client.wire.retry import RetryPolicy, policy_of
from equimesh_client.wire.session import AsyncSession
from equimesh_client.wire.transport import base_url
from equimesh_coupling.adaptation import Adaptation
from equimesh_schema.monitors import Norm


class AsyncClient:
    """A service of adaptive meshes; an asynchronous context manager. Arguments are those of :class:`Client`.

    Every method does what the method of that name of :class:`Client` does, and raises the same exceptions.
    """

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
        self._session = AsyncSession(settings, headers_with_key(headers, key))
        self.meshes = AsyncMeshes(self._session)
        self.samples = AsyncSamplesStore(self._session)
        self.sequences = AsyncSequences(self._session)

    @property
    def url(self) -> str:
        """The address of the service."""
        return self._session.settings.url

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
    ) -> AsyncMesh:
        """The finished mesh that is adapted to ``u``, of ``n`` points a side. See :meth:`Client.generate`."""
        complete = complete_options(options, self.generate)
        arguments = GenerateArguments(u=u, n=n, options=complete, initial=initial, cells=cells, reuse=reuse)
        return await self._generate(arguments, deadline, progress)

    async def _generate(self, arguments: GenerateArguments, deadline: float, progress: bool | None) -> AsyncMesh:
        limit, settings = Deadline.after(deadline), self._session.settings
        request = await self._session.run(flows.prepare(arguments, settings, limit))
        mesh = None
        try:
            with Watch(progress) as watch:
                hold = flows.hold_seconds(limit, watched=watch.shown)
                flow = flows.create(request, settings, wait=hold, deadline=limit)
                mesh = AsyncMesh(self._session, await self._session.run(flow))
                await mesh._wait(limit, watch)
        except (DeadlineExceeded, asyncio.CancelledError):
            await self._session.run(flows.abandon(request, mesh.id if mesh else None, settings))
            raise
        raise_unless_succeeded(mesh)
        return mesh

    async def adapt(
        self,
        solve: Solve,
        n: int | tuple[int, int] | None = None,
        *,
        domain: Domain | Mapping[str, Any] | None = None,
        rounds: int = 5,
        norm: Norm = "l2",
        observe: Observe | None = None,
        deadline: float = DEADLINE_SECONDS,
    ) -> Adaptation[AsyncMesh]:
        """The mesh that is adapted to the solution of a solver. See :meth:`Client.adapt`.

        ``solve`` gets the arrays of the mesh, whose ``to_skfem()`` and other methods need no await, and returns its
        solution or an awaitable of it.
        """
        loop: AdaptLoop[AsyncMesh] = AdaptLoop(solve=solve, n=n, domain=domain, rounds=rounds, norm=norm)
        settings = self._session.settings
        loop.domain = await self._session.run(flows.stored_domain(domain, settings, Deadline.after(deadline)))
        mesh = await self._generate(loop.first(), deadline, False)
        while True:
            try:
                arrays = await mesh.arrays()
                returned = solve(arrays)
                answered = loop.receive(arrays, await returned if isawaitable(returned) else returned)
                request = loop.next(answered)
                after = None if request is None else await self._generate(request, deadline, False)
                moved = None if after is None else await after.arrays()
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

    async def check(
        self,
        expression: str,
        *,
        parameters: Mapping[str, float] | None = None,
        t: float | None = None,
        domain: Domain | Mapping[str, Any] | None = None,
        deadline: float | None = None,
    ) -> dict[str, Any]:
        """The service's report on an expression on ``domain``. See :meth:`Client.check`."""
        domain = None if domain is None else domain_json(domain)
        return await self._session.fetch(protocol.check_expression(expression, parameters, t, domain), deadline)

    async def capabilities(self, *, deadline: float | None = None) -> dict[str, Any]:
        """Formats, limits, functions and transmission conditions of the service."""
        return await self._session.fetch(protocol.capabilities(), deadline)

    async def close(self) -> None:
        """Close all connections."""
        await self._session.close()

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


class AsyncMeshes:
    """The meshes of a service: ``client.meshes``."""

    def __init__(self, session: AsyncSession) -> None:
        self._session = session

    async def create(
        self,
        spec: Mapping[str, Any],
        *,
        samples: object = None,
        idempotency_key: str | None = None,
        reuse: bool = True,
        wait: int = 0,
        deadline: float | None = None,
    ) -> AsyncMesh:
        """A new mesh, from a complete spec of the HTTP interface, not yet finished. See :meth:`Meshes.create`."""
        request, settings = request_of_spec(spec, samples, idempotency_key, reuse=reuse), self._session.settings
        limit = settings.deadline(settings.attempts + wait if deadline is None else deadline)
        flow = flows.create(request, settings, wait=wait, deadline=limit)
        return AsyncMesh(self._session, await self._session.run(flow))

    async def get(self, mesh_id: str, *, deadline: float | None = None) -> AsyncMesh:
        """The mesh of that id; raises :class:`NotFound`."""
        return AsyncMesh(self._session, await self._session.fetch(protocol.get_mesh(mesh_id), deadline))

    async def list(
        self,
        *,
        status: str | None = None,
        label: str | None = None,
        limit: int | None = None,
        deadline: float | None = None,
    ) -> AsyncIterator[AsyncMesh]:
        """The meshes, newest first, at most ``limit``; fetched page by page, each within ``deadline``."""
        pages = Pages(status=status, label=label, limit=limit)
        while pages.more:
            page = await self._session.fetch(pages.next_call(), deadline)
            for record in pages.records(page):
                yield AsyncMesh(self._session, record)


class AsyncSamplesStore:
    """The stored samples of a service: ``client.samples``."""

    def __init__(self, session: AsyncSession) -> None:
        self._session = session

    async def upload(
        self,
        u: object,
        *,
        n_samples: int = 129,
        domain: Domain | Mapping[str, Any] | None = None,
        deadline: float | None = None,
    ) -> StoredSamples:
        """Samples stored once, for any number of meshes. See :meth:`SamplesStore.upload`."""
        settings = self._session.settings
        flow = flows.upload(u, n_samples, domain, settings, settings.deadline(deadline))
        return StoredSamples.from_json(await self._session.run(flow))

    async def upload_mesh(self, path: str | Path, *, deadline: float | None = None) -> StoredSamples:
        """A mesh file stored once; ``MeshFile(file=stored.id)`` is then the domain of any number of meshes."""
        call = protocol.upload_mesh(read_mesh_file(path))
        return StoredSamples.from_json(await self._session.fetch(call, deadline))

    async def get(self, samples_id: str, *, deadline: float | None = None) -> StoredSamples:
        """The stored samples of that id."""
        return StoredSamples.from_json(await self._session.fetch(protocol.stored_samples(samples_id), deadline))

    async def delete(self, samples: str | StoredSamples, *, deadline: float | None = None) -> None:
        """Delete stored samples."""
        samples_id = samples if isinstance(samples, str) else samples.id
        await self._session.delete(protocol.stored_samples(samples_id, method="DELETE"), deadline)
