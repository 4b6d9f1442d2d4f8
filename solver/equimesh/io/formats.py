"""The formats of mesh files: names, suffixes, media types, and who reads them."""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

Cells: TypeAlias = Literal["quad", "triangle"]
CELLS: Final = ("quad", "triangle")


@dataclass(frozen=True, kw_only=True)
class MeshFormat:
    """A file format: its short ``name``, file name ``suffix``, ``media_type``, and the programs that read it.

    ``cells`` are the kinds of cells that it can hold.
    """

    name: str
    suffix: str
    media_type: str
    description: str
    cells: tuple[Cells, ...] = CELLS


FORMATS: Final = {
    f.name: f
    for f in (
        MeshFormat(
            name="vtu",
            suffix=".vtu",
            media_type="application/vnd.vtk.vtu+xml",
            description="VTK XML unstructured grid: ParaView, VisIt, PyVista, meshio",
        ),
        MeshFormat(
            name="vtk",
            suffix=".vtk",
            media_type="application/vnd.vtk",
            description="legacy VTK 4.2, binary, with SfePy's node_groups: SfePy, ParaView, VisIt, PyVista",
        ),
        MeshFormat(
            name="vts",
            suffix=".vts",
            media_type="application/vnd.vtk.vts+xml",
            description="VTK XML structured grid, i along xi and j along eta, quadrilaterals: ParaView, VisIt, PyVista",
            cells=("quad",),
        ),
        MeshFormat(
            name="xdmf",
            suffix=".xdmf.zip",
            media_type="application/zip",
            description="zip of mesh.xdmf, mesh.h5, facets.xdmf, facets.h5 (side tags 1 left, 2 right, 3"
            " bottom, 4 top): FEniCSx dolfinx, legacy FEniCS, ParaView",
        ),
        MeshFormat(
            name="msh",
            suffix=".msh",
            media_type="model/mesh",
            description="Gmsh 2.2 text with physical groups left, right, bottom, top, domain: Gmsh, FreeFEM"
            " (gmshload), scikit-fem, FEniCSx dolfinx, PETSc, deal.II, MFEM, NGSolve, FiPy, SfePy",
        ),
        MeshFormat(
            name="medit",
            suffix=".mesh",
            media_type="model/x-medit",
            description="Medit text with references 1 left, 2 right, 3 bottom, 4 top: FreeFEM (readmesh,"
            " triangles), Mmg",
        ),
        MeshFormat(
            name="su2",
            suffix=".su2",
            media_type="model/x-su2",
            description="SU2 text with markers left, right, bottom, top: SU2",
        ),
        MeshFormat(
            name="foam",
            suffix=".foam.zip",
            media_type="application/x-openfoam+zip",
            description="zip of constant/polyMesh, one cell thick, with patches left, right, bottom, top, and"
            " frontAndBack of type empty: OpenFOAM",
        ),
        MeshFormat(
            name="npz",
            suffix=".npz",
            media_type="application/x-npz",
            description="NumPy arrays x, y, u, cells, q_eq, subdomain and the edges left, right, bottom, top",
        ),
    )
}
