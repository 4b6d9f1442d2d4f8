"""A mesh at the service, handed to other libraries."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from equimesh_client.wire.arrays import MeshArrays
from equimesh_client.wire.deadline import DEADLINE_SECONDS
from equimesh_client.wire.outcome import meshio_mesh
from equimesh_coupling.parts import Cells, MeshParts


class Coupled(ABC):
    """The ``to_...`` methods: each fetches the arrays once, and hands them over without a file.

    ``cells``, ``"quad"`` or ``"triangle"``, is the kind of cells; without it they are those of the request.

    Each raises ``MissingLibrary`` where the library is not installed, and ``OldLibrary`` where it is too old; the
    message names the package.
    """

    @abstractmethod
    def arrays(self, *, deadline: float = DEADLINE_SECONDS) -> MeshArrays:
        """All arrays of the mesh."""

    def mesh_parts(self, cells: Cells | None = None, *, deadline: float = DEADLINE_SECONDS) -> MeshParts:
        """Points, cells and sides as plain arrays, as ``equimesh_coupling`` has them."""
        return self.arrays(deadline=deadline).mesh_parts(cells)

    def to_meshio(self, *, deadline: float = DEADLINE_SECONDS) -> Any:
        """The mesh as a ``meshio.Mesh``, sides as cell sets; needs meshio."""
        return meshio_mesh(self.arrays(deadline=deadline))

    def to_skfem(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``skfem.MeshQuad`` or ``MeshTri`` with the four sides as ``boundaries``; needs scikit-fem."""
        return self.arrays(deadline=deadline).to_skfem(cells=cells)

    def to_dolfinx(self, comm: Any, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``dolfinx.mesh.Mesh`` on ``comm`` and the tags of its boundary facets, 1 to 4; needs FEniCSx."""
        return self.arrays(deadline=deadline).to_dolfinx(comm, cells=cells)

    def to_pyvista(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``pyvista.UnstructuredGrid`` with the edges of the four sides in ``field_data``; needs PyVista."""
        return self.arrays(deadline=deadline).to_pyvista(cells=cells)

    def to_fipy(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``fipy`` mesh with the four sides as masks in ``physicalFaces``; needs FiPy."""
        return self.arrays(deadline=deadline).to_fipy(cells=cells)

    def to_mfem(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """An ``mfem.ser.Mesh`` with boundary attributes 1 to 4; needs PyMFEM."""
        return self.arrays(deadline=deadline).to_mfem(cells=cells)

    def to_ngsolve(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """An ``ngsolve.Mesh`` with the four sides as boundaries by name; needs NGSolve."""
        return self.arrays(deadline=deadline).to_ngsolve(cells=cells)

    def to_sfepy(self, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``sfepy.discrete.fem.Mesh`` with the vertices of the four sides as sets by name; needs SfePy."""
        return self.arrays(deadline=deadline).to_sfepy(cells=cells)

    def to_dmplex(self, comm: Any, *, cells: Cells | None = None, deadline: float = DEADLINE_SECONDS) -> Any:
        """A ``petsc4py.PETSc.DMPlex`` on ``comm`` with 1 to 4 in the label ``Face Sets``; needs petsc4py."""
        return self.arrays(deadline=deadline).to_dmplex(comm, cells=cells)
