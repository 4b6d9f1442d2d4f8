"""A mesh at the service, for the blocking client."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from equimesh_client.blocking.coupled import Coupled
from equimesh_client.errors import DeadlineExceeded
from equimesh_client.progress_bar import Watch
from equimesh_client.records.convergence import Convergence
from equimesh_client.records.parts import Parts
from equimesh_client.records.quality import Quality
from equimesh_client.records.state import MeshState
from equimesh_client.records.tables import Array, IntArray
from equimesh_client.wire import flows, part_downloads, protocol
from equimesh_client.wire.archives import unpack_foam, unpack_xdmf
from equimesh_client.wire.arrays import MeshArrays, arrays_of
from equimesh_client.wire.deadline import DEADLINE_SECONDS, Deadline
from equimesh_client.wire.downloads import PartFile
from equimesh_client.wire.outcome import raise_unless_succeeded
from equimesh_client.wire.part_downloads import DEFAULT_FORMAT, PartArrays
from equimesh_client.wire.pictures import Plot, plot_format
from equimesh_client.wire.session import Session
from equimesh_client.wire.stream import Event, StreamPosition


class Mesh(Coupled, MeshState):
    """A mesh at the service. Arrays, quality and convergence are fetched on first use, and stored."""

    def __init__(self, session: Session, record: Mapping[str, Any]) -> None:
        super().__init__(record)
        self._session = session
        self._arrays: MeshArrays | None = None
        self._quality: Quality | None = None
        self._convergence: Convergence | None = None

    def refresh(self, *, deadline: float | None = None) -> Mesh:
        """The mesh itself, with the current record of the service."""
        self.record = self._session.fetch(protocol.get_mesh(self.id), deadline)
        return self

    def wait(self, *, progress: bool | None = None, deadline: float = DEADLINE_SECONDS) -> Mesh:
        """The mesh itself, once it is finished.

        Raises :class:`MeshFailed`, :class:`MeshCanceled`, or :class:`DeadlineExceeded` after ``deadline`` seconds.
        The deadline does not cancel the mesh, which can be waited for again.
        """
        with Watch(progress) as watch:
            self._wait(Deadline.after(deadline), watch)
        raise_unless_succeeded(self)
        return self

    def events(self, *, after: int = 0, deadline: float = DEADLINE_SECONDS) -> Iterator[Event]:
        """The events of the mesh after number ``after``, up to ``done``, as they happen.

        After a dropped connection the stream continues where it ended: no event is lost or repeated.
        """
        return self._session.follow(self.id, StreamPosition(last=after), Deadline.after(deadline))

    def cancel(self, *, deadline: float | None = None) -> Mesh:
        """The mesh itself, canceled or about to be; raises :class:`Conflict` for a finished mesh."""
        settings = self._session.settings
        self.record = self._session.run(flows.cancel(self.id, settings, settings.deadline(deadline)))
        return self

    def delete(self, *, deadline: float | None = None) -> None:
        """Delete the mesh and its files at the service."""
        self._session.delete(protocol.delete_mesh(self.id), deadline)

    @property
    def quality(self) -> Quality:
        """All quality measures; ``print(mesh.quality)`` shows a table."""
        if self._quality is None:
            call = protocol.mesh_part(self.id, "quality")
            self._quality = Quality.from_json(self._session.fetch(call))
        return self._quality

    def quality_of_cells(self, *, deadline: float | None = None) -> Quality:
        """All quality measures with their values per cell, ``quality.q_eq.cells`` and so on; fetched each time."""
        call = protocol.mesh_part(self.id, "quality", arrays="true")
        return Quality.from_json(self._session.fetch(call, deadline))

    @property
    def convergence(self) -> Convergence:
        """The Schwarz iteration; ``print(mesh.convergence)`` shows a table."""
        if self._convergence is None:
            call = protocol.mesh_part(self.id, "convergence")
            self._convergence = Convergence.from_json(self._session.fetch(call))
        return self._convergence

    def spec(self, *, deadline: float | None = None) -> dict[str, Any]:
        """The complete spec, with all defaults; creating it again gives the same mesh."""
        return self._session.fetch(protocol.mesh_part(self.id, "spec"), deadline)

    def download(
        self,
        path: str | Path,
        format: str | None = None,
        *,
        cells: str | None = None,
        partial: bool = False,
        deadline: float = DEADLINE_SECONDS,
    ) -> Path:
        """Write the mesh to ``path`` and return it; the format follows from the suffix.

        A ``.xdmf`` file comes with three others next to it; a ``.xdmf.zip`` file holds all four. A folder that exists
        is the case of an OpenFOAM solver, and gets the files of ``constant/polyMesh``.

        A complete file with the announced checksum is written, or none. An interrupted transfer continues where it
        ended, also in the next download to this name: until then the part stays next to the file, as
        ``.NAME.SHA256.part``. ``cells``, ``"quad"`` or ``"triangle"``, overrides the cells of the request.
        ``partial`` also accepts the mesh of a failed solve, unless it is folded. A mesh in parts is a ``.pvts``,
        ``.pvtu`` or ``.vtkhdf`` file, the head; the files of its parts are written next to it.
        """
        settings, limit = self._session.settings, Deadline.after(deadline)
        if part_downloads.is_of_parts(path, format):
            return self._session.run(part_downloads.download(self.id, path, format, settings, limit))
        call = protocol.mesh_file(self.id, protocol.format_of(str(path), format), cells=cells, partial=partial)
        if format is None and Path(path).suffix.lower() == ".xdmf":
            return unpack_xdmf(self._session.run(flows.fetch_file(call, settings, limit)), path)
        if format in (None, "foam") and Path(path).is_dir():
            return unpack_foam(self._session.run(flows.fetch_file(call, settings, limit)), path)
        with PartFile(path) as part:
            self._session.run(flows.save(call, settings, limit, part))
        return Path(path)

    def parts(self, format: str = DEFAULT_FORMAT, *, deadline: float | None = None) -> Parts:
        """The files of a mesh that a cluster has computed in parts: row ranges, names, sizes and checksums.

        Raises :class:`NotFound` for a mesh that is whole.
        """
        settings = self._session.settings
        return self._session.run(part_downloads.manifest(self.id, format, settings, settings.deadline(deadline)))

    def part(self, number: int, *, deadline: float = DEADLINE_SECONDS) -> PartArrays:
        """The arrays of one part of a mesh in parts; fetched each time."""
        settings, limit = self._session.settings, Deadline.after(deadline)
        return self._session.run(part_downloads.arrays_of_part(self.id, number, settings, limit))

    def download_parts(
        self, folder: str | Path, format: str = DEFAULT_FORMAT, *, deadline: float = DEADLINE_SECONDS
    ) -> Path:
        """Write all files of a mesh in parts into a folder, and return the path of the head, which opens them.

        Every file is checked against its checksum. Files that are there already are not sent again, so a download that
        was interrupted continues. Raises :class:`BadArgument` for a folder that does not exist.
        """
        settings, limit = self._session.settings, Deadline.after(deadline)
        return self._session.run(part_downloads.download_parts(self.id, folder, format, settings, limit))

    def arrays(self, *, deadline: float = DEADLINE_SECONDS) -> MeshArrays:
        """All arrays of the mesh, fetched once."""
        if self._arrays is None:
            call, limit = protocol.mesh_file(self.id, "npz"), Deadline.after(deadline)
            flow = flows.fetch_file(call, self._session.settings, limit)
            self._arrays = arrays_of(self._session.run(flow))
        return self._arrays

    @property
    def points(self) -> Array:
        """Node coordinates, shape ``(n, 2)``, where n is ``n_xi * n_eta`` for a grid."""
        return self.arrays().points

    @property
    def cells(self) -> IntArray:
        """Nodes of every cell, counter-clockwise, shape ``(m, 4)``, or ``(m, 3)`` for triangles."""
        return self.arrays().cells

    @property
    def boundary(self) -> Mapping[str, IntArray]:
        """Edges ``(k, 2)`` of the sides ``left``, ``right``, ``bottom`` and ``top``, or of those of blocks by name."""
        return self.arrays().boundary

    @property
    def blocks(self) -> Mapping[str, IntArray]:
        """The nodes of each block, shape ``(n_i, n_j)``, by its name; empty for a mesh of a grid."""
        return self.arrays().blocks

    @property
    def x(self) -> Array:
        """The x coordinates, shape ``(n_xi, n_eta)``, or ``(n,)`` of blocks."""
        return self.arrays().x

    @property
    def y(self) -> Array:
        """The y coordinates, shape ``(n_xi, n_eta)``, or ``(n,)`` of blocks."""
        return self.arrays().y

    @property
    def u(self) -> Array | None:
        """The values of u at the nodes, shape ``(n_xi, n_eta)``; None where the monitor has no u."""
        return self.arrays().u

    def plot(
        self,
        path: str | Path | None = None,
        kind: str = "mesh",
        *,
        format: str | None = None,
        deadline: float | None = None,
    ) -> Plot:
        """A picture drawn by the service, written to ``path`` if given. A notebook shows it.

        ``kind`` is ``"mesh"``, ``"quality"``, ``"convergence"`` or ``"comparison"``: the mesh next to the uniform one,
        with the error of each cell. The format is svg, unless the suffix or ``format`` is png.
        """
        format, settings = plot_format(path, format), self._session.settings
        flow = flows.request(protocol.mesh_plot(self.id, kind, format), settings, settings.deadline(deadline))
        plot = Plot(data=self._session.run(flow).body, format=format)
        if path is not None:
            plot.save(path)
        return plot

    def _wait(self, deadline: Deadline, watch: Watch) -> None:
        def report(record: Mapping[str, Any]) -> None:
            self.record = dict(record)
            watch.update(record)

        try:
            flow = flows.wait(self.record, self._session.settings, deadline, watched=watch.shown)
            self._session.run(flow, report)
        except DeadlineExceeded as error:
            error.mesh = self
            raise
