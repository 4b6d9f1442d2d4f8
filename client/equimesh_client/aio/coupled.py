"""A mesh at the service, handed to other libraries, for asyncio: the twin of ``equimesh_client.blocking.coupled``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from equimesh_client.wire.arrays import MeshArrays
from equimesh_client.wire.deadline import DEADLINE_SECONDS
from equimesh_client.wire.outcome import meshio_mesh
from equimesh_coupling.parts import Cells, MeshParts


class AsyncCoupled(ABC):
    """The ``to_...`` methods: each fetches the arrays once, and hands them over without a file.

    ``cells``, ``"quad"`` or ``"triangle"``, is the kind of cells; without it they are those of the request.

    Each raises ``MissingLibrary`` where the library is not installed, and ``OldLibrary`` where it is too old; the
    message names the package.
    """

    @abstractmethod
    async def arrays(self, *, deadline: float = DEADLINE_SECONDS) -> MeshArrays:
        """All arrays of the mesh."""

    async def mesh_parts(self, cells: Cells | None = None, *, deadline: float = DEADLINE_SECONDS) -> MeshParts:
        """Points, cells and sides as plain arrays, as ``equimesh_coupling`` has them."""
        return (await self.arrays(deadline=deadline)).mesh_parts(cells)

    async def to_meshio(self, *, deadline: float = DEADLINE_SECONDS) -> Any:
        """The mesh as a ``meshio.Mesh``, sides as cell sets; needs meshio."""
        return meshio_mesh(await self.arrays(deadline=deadline))

    async def to_skfem(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``skfem.MeshQuad`` or ``MeshTri`` with the four sides as ``boundaries``; needs scikit-fem."""
        return (await self.arrays(deadline=deadline)).to_skfem(cells=cells)

    async def to_dolfinx(self, comm: Any, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``dolfinx.mesh.Mesh`` on ``comm`` and the tags of its boundary facets, 1 to 4; needs FEniCSx."""
        return (await self.arrays(deadline=deadline)).to_dolfinx(comm, cells=cells)

    async def to_pyvista(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``pyvista.UnstructuredGrid`` with the edges of the four sides in ``field_data``; needs PyVista."""
        return (await self.arrays(deadline=deadline)).to_pyvista(cells=cells)

    async def to_fipy(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``fipy`` mesh with the four sides as masks in ``physicalFaces``; needs FiPy."""
        return (await self.arrays(deadline=deadline)).to_fipy(cells=cells)

    async def to_mfem(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """An ``mfem.ser.Mesh`` with boundary attributes 1 to 4; needs PyMFEM."""
        return (await self.arrays(deadline=deadline)).to_mfem(cells=cells)

    async def to_ngsolve(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """An ``ngsolve.Mesh`` with the four sides as boundaries by name; needs NGSolve."""
        return (await self.arrays(deadline=deadline)).to_ngsolve(cells=cells)

    async def to_sfepy(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``sfepy.discrete.fem.Mesh`` with the vertices of the four sides as sets by name; needs SfePy."""
        return (await self.arrays(deadline=deadline)).to_sfepy(cells=cells)

    async def to_dmplex(self, comm: Any, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``petsc4py.PETSc.DMPlex`` on ``comm`` with 1 to 4 in the label ``Face Sets``; needs petsc4py."""
        return (await self.arrays(deadline=deadline)).to_dmplex(comm, cells=cells)
