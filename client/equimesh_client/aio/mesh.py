"""A mesh at the service, for asyncio: the twin of ``equimesh_client.blocking.mesh``."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

from equimesh_client.aio.coupled import AsyncCoupled
from equimesh_client.errors import DeadlineExceeded
from equimesh_client.progress_bar import Watch
from equimesh_client.records.convergence import Convergence
from equimesh_client.records.parts import Parts
from equimesh_client.records.quality import Quality
from equimesh_client.records.state import MeshState
from equimesh_client.wire import flows, part_downloads, protocol
from equimesh_client.wire.archives import unpack_foam, unpack_xdmf
from equimesh_client.wire.arrays import MeshArrays, arrays_of
from equimesh_client.wire.deadline import DEADLINE_SECONDS, Deadline
from equimesh_client.wire.downloads import PartFile
from equimesh_client.wire.outcome import raise_unless_succeeded
from equimesh_client.wire.part_downloads import DEFAULT_FORMAT, PartArrays
from equimesh_client.wire.pictures import Plot, plot_format
from equimesh_client.wire.session import AsyncSession
from equimesh_client.wire.stream import Event, StreamPosition


class AsyncMesh(AsyncCoupled, MeshState):
    """A mesh at the service. Arrays, quality and convergence are fetched on first use, and stored."""

    def __init__(self, session: AsyncSession, record: Mapping[str, Any]) -> None:
        super().__init__(record)
        self._session = session
        self._arrays: MeshArrays | None = None
        self._quality: Quality | None = None
        self._convergence: Convergence | None = None

    async def refresh(self, *, deadline: float | None = None) -> AsyncMesh:
        """The mesh itself, with the current record of the service."""
        self.record = await self._session.fetch(protocol.get_mesh(self.id), deadline)
        return self

    async def wait(self, *, progress: bool | None = None, deadline: float = DEADLINE_SECONDS) -> AsyncMesh:
        """The mesh itself, once it is finished. See :meth:`Mesh.wait`."""
        with Watch(progress) as watch:
            await self._wait(Deadline.after(deadline), watch)
        raise_unless_succeeded(self)
        return self

    def events(self, *, after: int = 0, deadline: float = DEADLINE_SECONDS) -> AsyncIterator[Event]:
        """The events of the mesh after number ``after``, up to ``done``, as they happen. See :meth:`Mesh.events`."""
        return self._session.follow(self.id, StreamPosition(last=after), Deadline.after(deadline))

    async def cancel(self, *, deadline: float | None = None) -> AsyncMesh:
        """The mesh itself, canceled or about to be; raises :class:`Conflict` for a finished mesh."""
        settings = self._session.settings
        self.record = await self._session.run(flows.cancel(self.id, settings, settings.deadline(deadline)))
        return self

    async def delete(self, *, deadline: float | None = None) -> None:
        """Delete the mesh and its files at the service."""
        await self._session.delete(protocol.delete_mesh(self.id), deadline)

    async def quality(self, *, deadline: float | None = None) -> Quality:
        """All quality measures; ``print(await mesh.quality())`` shows a table."""
        if self._quality is None:
            call = protocol.mesh_part(self.id, "quality")
            self._quality = Quality.from_json(await self._session.fetch(call, deadline))
        return self._quality

    async def quality_of_cells(self, *, deadline: float | None = None) -> Quality:
        """All quality measures with their values per cell, ``quality.q_eq.cells`` and so on; fetched each time."""
        call = protocol.mesh_part(self.id, "quality", arrays="true")
        return Quality.from_json(await self._session.fetch(call, deadline))

    async def convergence(self, *, deadline: float | None = None) -> Convergence:
        """The Schwarz iteration; ``print(await mesh.convergence())`` shows a table."""
        if self._convergence is None:
            call = protocol.mesh_part(self.id, "convergence")
            self._convergence = Convergence.from_json(await self._session.fetch(call, deadline))
        return self._convergence

    async def spec(self, *, deadline: float | None = None) -> dict[str, Any]:
        """The complete spec, with all defaults; creating it again gives the same mesh."""
        return await self._session.fetch(protocol.mesh_part(self.id, "spec"), deadline)

    async def download(
        self,
        path: str | Path,
        format: str | None = None,
        *,
        cells: str | None = None,
        partial: bool = False,
        deadline: float = DEADLINE_SECONDS,
    ) -> Path:
        """Write the mesh to ``path`` and return it; the format follows from the suffix. See :meth:`Mesh.download`."""
        settings, limit = self._session.settings, Deadline.after(deadline)
        if part_downloads.is_of_parts(path, format):
            return await self._session.run(part_downloads.download(self.id, path, format, settings, limit))
        call = protocol.mesh_file(self.id, protocol.format_of(str(path), format), cells=cells, partial=partial)
        if format is None and Path(path).suffix.lower() == ".xdmf":
            return unpack_xdmf(await self._session.run(flows.fetch_file(call, settings, limit)), path)
        if format in (None, "foam") and Path(path).is_dir():
            return unpack_foam(await self._session.run(flows.fetch_file(call, settings, limit)), path)
        with PartFile(path) as part:
            await self._session.run(flows.save(call, settings, limit, part))
        return Path(path)

    async def parts(self, format: str = DEFAULT_FORMAT, *, deadline: float | None = None) -> Parts:
        """The files of a mesh that a cluster has computed in parts. See :meth:`Mesh.parts`."""
        settings = self._session.settings
        return await self._session.run(part_downloads.manifest(self.id, format, settings, settings.deadline(deadline)))

    async def part(self, number: int, *, deadline: float = DEADLINE_SECONDS) -> PartArrays:
        """The arrays of one part of a mesh in parts; fetched each time."""
        settings, limit = self._session.settings, Deadline.after(deadline)
        return await self._session.run(part_downloads.arrays_of_part(self.id, number, settings, limit))

    async def download_parts(
        self, folder: str | Path, format: str = DEFAULT_FORMAT, *, deadline: float = DEADLINE_SECONDS
    ) -> Path:
        """Write all files of a mesh in parts into a folder, and return the path of the head.

        See :meth:`Mesh.download_parts`.
        """
        settings, limit = self._session.settings, Deadline.after(deadline)
        return await self._session.run(part_downloads.download_parts(self.id, folder, format, settings, limit))

    async def arrays(self, *, deadline: float = DEADLINE_SECONDS) -> MeshArrays:
        """All arrays of the mesh, fetched once: points, cells, boundary, x, y, u."""
        if self._arrays is None:
            call, limit = protocol.mesh_file(self.id, "npz"), Deadline.after(deadline)
            flow = flows.fetch_file(call, self._session.settings, limit)
            self._arrays = arrays_of(await self._session.run(flow))
        return self._arrays

    async def plot(
        self,
        path: str | Path | None = None,
        kind: str = "mesh",
        *,
        format: str | None = None,
        deadline: float | None = None,
    ) -> Plot:
        """A picture drawn by the service, written to ``path`` if given. A notebook shows it. See :meth:`Mesh.plot`."""
        format, settings = plot_format(path, format), self._session.settings
        flow = flows.request(protocol.mesh_plot(self.id, kind, format), settings, settings.deadline(deadline))
        plot = Plot(data=(await self._session.run(flow)).body, format=format)
        if path is not None:
            plot.save(path)
        return plot

    async def _wait(self, deadline: Deadline, watch: Watch) -> None:
        def report(record: Mapping[str, Any]) -> None:
            self.record = dict(record)
            watch.update(record)

        try:
            flow = flows.wait(self.record, self._session.settings, deadline, watched=watch.shown)
            await self._session.run(flow, report)
        except DeadlineExceeded as error:
            error.mesh = self
            raise
