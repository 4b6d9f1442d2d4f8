"""The methods that hand a mesh to another library, for every class of meshes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

from equimesh_coupling.adaptors import dmplex, dolfinx, fipy, mfem, ngsolve, pyvista, sfepy, skfem
from equimesh_coupling.display import draw_on, facts_of, picture
from equimesh_coupling.parts import Cells, MeshParts
from equimesh_schema.notebook import html_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Coupled(ABC):
    """A mesh that other libraries take as arrays, without a file.

    Each method imports its library when it is called. The nodes of the foreign mesh are those of this mesh, in the same
    order wherever the library keeps an order. ``cells``, ``"quad"`` or ``"triangle"``, is the kind of cells; without it
    the mesh decides. The sides keep their names: those of a grid are ``left``, ``right``, ``bottom`` and ``top``. A
    library that knows numbers only has 1, 2, 3 and so on, in the order of the sides.

    Each method raises :class:`~equimesh_coupling.MissingLibrary` where the library is not installed, and
    :class:`~equimesh_coupling.OldLibrary` where it is too old; the message names the package.
    """

    @abstractmethod
    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """Points, cells and sides as plain arrays."""

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the mesh on ``axes`` of matplotlib, or on those of pyplot, and return them; needs matplotlib."""
        return draw_on(self, None, axes)

    def _repr_html_(self) -> str:
        """A picture and a table, for notebooks."""
        return html_of("A mesh", facts_of(self.mesh_parts()), picture=picture(self), alternative="the mesh")

    def to_skfem(self, *, cells: Cells | None = None) -> Any:
        """A ``skfem.MeshQuad`` or ``MeshTri`` with the sides as ``boundaries``; needs scikit-fem."""
        return skfem.mesh_of(self.mesh_parts(cells))

    def to_dolfinx(self, comm: Any, *, cells: Cells | None = None) -> Any:
        """A ``dolfinx.mesh.Mesh`` on ``comm`` and the tags of its boundary facets, from 1; needs FEniCSx."""
        return dolfinx.mesh_of(self.mesh_parts(cells), comm)

    def to_pyvista(self, *, cells: Cells | None = None) -> Any:
        """A ``pyvista.UnstructuredGrid`` with the edges of the sides in ``field_data``; needs PyVista."""
        return pyvista.mesh_of(self.mesh_parts(cells))

    def to_fipy(self, *, cells: Cells | None = None) -> Any:
        """A ``fipy`` mesh with the sides as masks in ``physicalFaces``; needs FiPy."""
        return fipy.mesh_of(self.mesh_parts(cells))

    def to_mfem(self, *, cells: Cells | None = None) -> Any:
        """An ``mfem.ser.Mesh`` with boundary attributes from 1; needs PyMFEM."""
        return mfem.mesh_of(self.mesh_parts(cells))

    def to_ngsolve(self, *, cells: Cells | None = None) -> Any:
        """An ``ngsolve.Mesh`` with the sides as boundaries by name; needs NGSolve."""
        return ngsolve.mesh_of(self.mesh_parts(cells))

    def to_sfepy(self, *, cells: Cells | None = None) -> Any:
        """A ``sfepy.discrete.fem.Mesh`` with the vertices of the sides as sets by name; needs SfePy."""
        return sfepy.mesh_of(self.mesh_parts(cells))

    def to_dmplex(self, comm: Any, *, cells: Cells | None = None) -> Any:
        """A ``petsc4py.PETSc.DMPlex`` on ``comm`` and the sides, from 1, in its label ``Face Sets``; needs petsc4py."""
        return dmplex.mesh_of(self.mesh_parts(cells), comm)
