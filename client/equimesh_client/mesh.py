"""A mesh at the service, for both clients."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from equimesh_client.errors import DeadlineExceeded, EquimeshClientError
from equimesh_client.operation import Awaiting, Blocking, finish, operation
from equimesh_client.progress_bar import Watch
from equimesh_client.records.measures import Array, Convergence, IntArray, Quality
from equimesh_client.records.resources import MeshState
from equimesh_client.wire import flows, part_downloads, protocol
from equimesh_client.wire.arrays import (
    Drawn,
    MeshArrays,
    Plot,
    arrays_of,
    drawn_of,
    meshio_mesh,
    plot_format,
    raise_unless_succeeded,
)
from equimesh_client.wire.downloads import PartFile, unpacking
from equimesh_client.wire.part_downloads import DEFAULT_FORMAT, PartArrays
from equimesh_client.wire.settings import DEADLINE_SECONDS, Deadline
from equimesh_client.wire.stream import Event, StreamPosition
from equimesh_client.wire.transport import Session
from equimesh_coupling.display import draw_on, is_axes, picture
from equimesh_coupling.parts import Cells, MeshParts
from equimesh_schema.answers import Parts
from equimesh_schema.notebook import html_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE_SECONDS = 10.0
"""Seconds that a notebook waits for the picture of a mesh."""

M = TypeVar("M", bound="MeshOperations[Any]")
"""The class of the meshes of a client."""


class MeshOperations(MeshState, Generic[M]):
    """What a mesh of either client does.

    The ``to_...`` methods hand the mesh to another library without a file. ``cells``, ``"quad"`` or ``"triangle"``, is
    the kind of cells; without it they are those of the request. They raise ``MissingLibrary`` where the library is not
    installed, and ``OldLibrary`` where it is too old; the message names the package.
    """

    _session: Session

    def __init__(self, session: Session, record: Mapping[str, Any]) -> None:
        super().__init__(record)
        self._session = session
        self._arrays: MeshArrays | None = None
        self._drawn: Drawn | None = None
        self._quality: Quality | None = None
        self._convergence: Convergence | None = None

    @operation
    async def refresh(self, *, deadline: float | None = None) -> M:
        """The mesh itself, with the current record of the service."""
        self.record = await self._session.fetch(protocol.get_mesh(self.id), deadline)
        return cast("M", self)

    @operation
    async def wait(self, *, progress: bool | None = None, deadline: float = DEADLINE_SECONDS) -> M:
        """The mesh itself, once it is finished.

        Raises :class:`MeshFailed`, :class:`MeshCanceled`, or :class:`DeadlineExceeded` after ``deadline`` seconds.
        The deadline does not cancel the mesh, which can be waited for again.
        """
        with Watch(progress) as watch:
            await self._wait(Deadline.after(deadline), watch)
            raise_unless_succeeded(self)
        return cast("M", self)

    @operation
    def events(self, *, after: int = 0, deadline: float = DEADLINE_SECONDS) -> AsyncIterator[Event]:
        """The events of the mesh after number ``after``, up to ``done``, as they happen.

        After a dropped connection the stream continues where it ended: no event is lost or repeated.
        """
        return self._session.follow(self.id, StreamPosition(last=after), Deadline.after(deadline))

    @operation
    async def cancel(self, *, deadline: float | None = None) -> M:
        """The mesh itself, canceled or about to be; raises :class:`Conflict` for a finished mesh."""
        settings = self._session.settings
        self.record = await self._session.run(flows.cancel(self.id, settings, settings.deadline(deadline)))
        return cast("M", self)

    @operation
    async def delete(self, *, deadline: float | None = None) -> None:
        """Delete the mesh and its files at the service."""
        await self._session.delete(protocol.delete_mesh(self.id), deadline)

    @operation
    async def quality_of_cells(self, *, deadline: float | None = None) -> Quality:
        """All quality measures with their values per cell, ``quality.q_eq.cells`` and so on; fetched each time."""
        call = protocol.mesh_part(self.id, "quality", arrays="true")
        return Quality.from_json(await self._session.fetch(call, deadline))

    @operation
    async def spec(self, *, deadline: float | None = None) -> dict[str, Any]:
        """The complete spec, with all defaults; creating it again gives the same mesh."""
        return await self._session.fetch(protocol.mesh_part(self.id, "spec"), deadline)

    @operation
    async def download(
        self,
        path: str | Path,
        format: str | None = None,
        *,
        cells: str | None = None,
        order: int = 1,
        partial: bool = False,
        deadline: float = DEADLINE_SECONDS,
    ) -> Path:
        """Write the mesh to ``path`` and return it; the format follows from the suffix.

        A ``.xdmf`` file comes with three others next to it; a ``.xdmf.zip`` file holds all four. A folder that exists
        is the case of an OpenFOAM solver, and gets the files of ``constant/polyMesh``.

        A complete file with the announced checksum is written, or none. An interrupted transfer continues where it
        ended, also in the next download to this name: until then the part stays next to the file, as
        ``.NAME.SHA256.part``. ``cells``, ``"quad"`` or ``"triangle"``, overrides the cells of the request.
        With ``order=2`` cells of a vtu, hdf, msh, inp, ism, re2 or specfem file have a node in the middle of each
        edge, on curved sides on the curve. ``partial`` also accepts the mesh of a failed solve, unless it is folded. A
        mesh in parts is a ``.pvtu`` or ``.vtkhdf`` file, the head; the files of its parts are written next to it.
        """
        settings, limit = self._session.settings, Deadline.after(deadline)
        if part_downloads.is_of_parts(path, format):
            return await self._session.run(part_downloads.download(self.id, path, format, settings, limit))
        call = protocol.mesh_file(
            self.id, protocol.format_of(str(path), format), cells=cells, order=order, partial=partial
        )
        unpack = unpacking(path, format)
        if unpack is not None:
            return unpack(await self._session.run(flows.fetch_file(call, settings, limit)), path)
        with PartFile(path) as part:
            await self._session.run(flows.save(call, settings, limit, part))
        return Path(path)

    @operation
    async def parts(self, format: str = DEFAULT_FORMAT, *, deadline: float | None = None) -> Parts:
        """The files of a mesh that a cluster has computed in parts: row ranges, names, sizes and checksums.

        Raises :class:`NotFound` for a mesh that is whole.
        """
        settings = self._session.settings
        return await self._session.run(part_downloads.manifest(self.id, format, settings, settings.deadline(deadline)))

    @operation
    async def part(self, number: int, *, deadline: float = DEADLINE_SECONDS) -> PartArrays:
        """The arrays of one part of a mesh in parts; fetched each time."""
        settings, limit = self._session.settings, Deadline.after(deadline)
        return await self._session.run(part_downloads.arrays_of_part(self.id, number, settings, limit))

    @operation
    async def download_parts(
        self, folder: str | Path, format: str = DEFAULT_FORMAT, *, deadline: float = DEADLINE_SECONDS
    ) -> Path:
        """Write all files of a mesh in parts into a folder, and return the path of the head, which opens them.

        Every file is checked against its checksum. Files that are there already are not sent again, so a download that
        was interrupted continues. Raises :class:`BadArgument` for a folder that does not exist.
        """
        settings, limit = self._session.settings, Deadline.after(deadline)
        return await self._session.run(part_downloads.download_parts(self.id, folder, format, settings, limit))

    @operation
    async def arrays(self, *, deadline: float = DEADLINE_SECONDS) -> MeshArrays:
        """All arrays of the mesh, fetched once."""
        return await self._fetched(deadline)

    @operation
    async def mesh_parts(self, cells: Cells | None = None, *, deadline: float = DEADLINE_SECONDS) -> MeshParts:
        """Points, cells and sides as plain arrays, as ``equimesh_coupling`` has them."""
        return (await self._fetched(deadline)).mesh_parts(cells)

    @operation
    async def to_meshio(self, *, deadline: float = DEADLINE_SECONDS) -> Any:
        """The mesh as a ``meshio.Mesh``, sides as cell sets; needs meshio."""
        return meshio_mesh(await self._fetched(deadline))

    @operation
    async def to_skfem(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``skfem.MeshQuad`` or ``MeshTri`` with the four sides as ``boundaries``; needs scikit-fem."""
        return (await self._fetched(deadline)).to_skfem(cells=cells)

    @operation
    async def to_dolfinx(self, comm: Any, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``dolfinx.mesh.Mesh`` on ``comm`` and the tags of its boundary facets, 1 to 4; needs FEniCSx."""
        return (await self._fetched(deadline)).to_dolfinx(comm, cells=cells)

    @operation
    async def to_pyvista(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``pyvista.UnstructuredGrid`` with the edges of the four sides in ``field_data``; needs PyVista."""
        return (await self._fetched(deadline)).to_pyvista(cells=cells)

    @operation
    async def to_fipy(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``fipy`` mesh with the four sides as masks in ``physicalFaces``; needs FiPy."""
        return (await self._fetched(deadline)).to_fipy(cells=cells)

    @operation
    async def to_mfem(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """An ``mfem.ser.Mesh`` with boundary attributes 1 to 4; needs PyMFEM."""
        return (await self._fetched(deadline)).to_mfem(cells=cells)

    @operation
    async def to_ngsolve(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """An ``ngsolve.Mesh`` with the four sides as boundaries by name; needs NGSolve."""
        return (await self._fetched(deadline)).to_ngsolve(cells=cells)

    @operation
    async def to_sfepy(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``sfepy.discrete.fem.Mesh`` with the vertices of the four sides as sets by name; needs SfePy."""
        return (await self._fetched(deadline)).to_sfepy(cells=cells)

    @operation
    async def to_dmplex(self, comm: Any, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``petsc4py.PETSc.DMPlex`` on ``comm`` with 1 to 4 in the label ``Face Sets``; needs petsc4py."""
        return (await self._fetched(deadline)).to_dmplex(comm, cells=cells)

    @operation
    async def plot(
        self,
        path: str | Path | Axes | None = None,
        kind: str = "mesh",
        *,
        format: str | None = None,
        deadline: float | None = None,
    ) -> Any:
        """A :class:`Plot` drawn by the service, written to ``path`` if given. A notebook shows it.

        Axes of matplotlib in place of a path are drawn on, every cell with the colour of its error, and returned.

        ``kind`` is ``"mesh"``, ``"quality"``, ``"convergence"`` or ``"comparison"``: the mesh next to the uniform one,
        with the error of each cell. The format is svg, unless the suffix or ``format`` is png.
        """
        if is_axes(path):
            drawn = await self._drawing(deadline)
            return draw_on(drawn, drawn.error, cast("Axes", path))
        path = cast("str | Path | None", path)
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

    async def _drawing(self, deadline: float | None = None) -> Drawn:
        if self._drawn is None:
            settings = self._session.settings
            flow = flows.fetch_file(protocol.mesh_drawing(self.id), settings, settings.deadline(deadline))
            self._drawn = drawn_of(await self._session.run(flow))
        return self._drawn

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks; the picture once the drawing has been fetched."""
        certificate, drawn = self.certificate, self._drawn
        facts = [("id", self.id), ("status", self.status)]
        if drawn is not None:
            facts.append(("points", " x ".join(map(str, drawn.x.shape))))
        if certificate is None:
            return html_of(f"A mesh at the service, {self.progress.phase or self.status}", facts)
        facts += certificate.facts[1:]
        image = None if drawn is None else picture(drawn, drawn.error)
        return html_of(certificate.headline, facts, self.warnings, image)

    async def _fetched(self, deadline: float) -> MeshArrays:
        if self._arrays is None:
            call, limit = protocol.mesh_file(self.id, "npz"), Deadline.after(deadline)
            flow = flows.fetch_file(call, self._session.settings, limit)
            self._arrays = arrays_of(await self._session.run(flow))
        return self._arrays

    async def _measures(self, deadline: float | None = None) -> Quality:
        if self._quality is None:
            call = protocol.mesh_part(self.id, "quality")
            self._quality = Quality.from_json(await self._session.fetch(call, deadline))
        return self._quality

    async def _iterations(self, deadline: float | None = None) -> Convergence:
        if self._convergence is None:
            call = protocol.mesh_part(self.id, "convergence")
            self._convergence = Convergence.from_json(await self._session.fetch(call, deadline))
        return self._convergence


class Mesh(Blocking, MeshOperations["Mesh"]):
    """A mesh at the service. Arrays, quality and convergence are fetched on first use, and stored."""

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks. The picture is fetched on first use, where the service answers."""
        if self.status == "succeeded":
            with suppress(EquimeshClientError, RuntimeError):  # httpx raises the second where the client is closed
                finish(self._drawing(PICTURE_SECONDS))
        return super()._repr_html_()

    @property
    def quality(self) -> Quality:
        """All quality measures; ``print(mesh.quality)`` shows a table."""
        return finish(self._measures())

    @property
    def convergence(self) -> Convergence:
        """The Schwarz iteration; ``print(mesh.convergence)`` shows a table."""
        return finish(self._iterations())

    @property
    def points(self) -> Array:
        """Node coordinates, shape ``(n, 2)``, where n is ``n_xi * n_eta`` for a grid."""
        return self.arrays().points

    @property
    def cells(self) -> IntArray:
        """Nodes of every cell, counter-clockwise, shape ``(m, 4)``, or ``(m, 3)`` for triangles."""
        return self.arrays().cells

    @property
    def sides(self) -> Mapping[str, IntArray]:
        """Edges ``(k, 2)`` of the sides ``left``, ``right``, ``bottom`` and ``top``, or of those of blocks by name."""
        return self.arrays().sides

    @property
    def boundary(self) -> Mapping[str, IntArray]:
        """The same as :attr:`sides`, which is its name in ``equimesh``, too."""
        return self.sides

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


class AsyncMesh(Awaiting, MeshOperations["AsyncMesh"]):
    """A mesh at the service, for asyncio. Arrays, quality and convergence are fetched on first use, and stored."""

    async def quality(self, *, deadline: float | None = None) -> Quality:
        """All quality measures; ``print(await mesh.quality())`` shows a table."""
        return await self._measures(deadline)

    async def convergence(self, *, deadline: float | None = None) -> Convergence:
        """The Schwarz iteration; ``print(await mesh.convergence())`` shows a table."""
        return await self._iterations(deadline)
