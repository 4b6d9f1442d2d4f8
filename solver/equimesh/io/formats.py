"""The formats of mesh files: names, suffixes, media types, and who reads them."""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

Cells: TypeAlias = Literal["quad", "triangle"]
CELLS: Final = ("quad", "triangle")


@dataclass(frozen=True, kw_only=True)
class MeshFormat:
    """A file format: its short ``name``, file name ``suffix``, ``media_type``, and the programs that read it.

    ``cells`` are the kinds of cells that it can hold. ``grids_only`` formats hold no mesh of blocks. ``second_order``
    ones also hold cells of second order.
    """

    name: str
    suffix: str
    media_type: str
    description: str
    cells: tuple[Cells, ...] = CELLS
    grids_only: bool = False
    second_order: bool = False


FORMATS: Final = {
    f.name: f
    for f in (
        MeshFormat(
            name="vtu",
            suffix=".vtu",
            media_type="application/vnd.vtk.vtu+xml",
            description="VTK XML unstructured grid: ParaView, VisIt, PyVista, meshio",
            second_order=True,
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
            grids_only=True,
        ),
        MeshFormat(
            name="vtm",
            suffix=".vtm.zip",
            media_type="application/x-vtm+zip",
            description="zip of mesh.vtm and a VTK XML structured grid for each block, quadrilaterals: ParaView,"
            " VisIt, PyVista",
            cells=("quad",),
        ),
        MeshFormat(
            name="hdf",
            suffix=".hdf",
            media_type="application/x-vtkhdf",
            description="VTKHDF unstructured grid, with node_groups of the sides: ParaView, PyVista, h5py",
            second_order=True,
        ),
        MeshFormat(
            name="xdmf",
            suffix=".xdmf.zip",
            media_type="application/zip",
            description="zip of mesh.xdmf, mesh.h5, facets.xdmf, facets.h5 (the numbers of the sides"
            " as tags): FEniCSx dolfinx, legacy FEniCS, ParaView",
        ),
        MeshFormat(
            name="msh",
            suffix=".msh",
            media_type="model/mesh",
            description="Gmsh 2.2 text with physical groups of the sides, such as left, and domain: Gmsh, FreeFEM"
            " (gmshload), scikit-fem, FEniCSx dolfinx, PETSc, deal.II, MFEM, NGSolve, FiPy, SfePy",
            second_order=True,
        ),
        MeshFormat(
            name="medit",
            suffix=".mesh",
            media_type="model/x-medit",
            description="Medit text with the numbers of the sides as references: FreeFEM (readmesh, triangles), Mmg",
        ),
        MeshFormat(
            name="su2",
            suffix=".su2",
            media_type="model/x-su2",
            description="SU2 text with a marker for each side: SU2",
        ),
        MeshFormat(
            name="abaqus",
            suffix=".inp",
            media_type="application/x-abaqus",
            description="Abaqus input with a node set and a surface for each side: p4est, Trixi, deal.II, CalculiX,"
            " meshio",
            second_order=True,
        ),
        MeshFormat(
            name="hohqmesh",
            suffix=".ism",
            media_type="application/x-hohqmesh",
            description="HOHQMesh's ISM-V2 text, quadrilaterals, sides by their names: Trixi",
            cells=("quad",),
            second_order=True,
        ),
        MeshFormat(
            name="re2",
            suffix=".re2",
            media_type="application/x-nek5000",
            description="Nek5000's binary mesh, quadrilaterals, with the number of its side at a face: Nek5000, Neko",
            cells=("quad",),
            second_order=True,
        ),
        MeshFormat(
            name="nmsh",
            suffix=".nmsh",
            media_type="application/x-neko",
            description="Neko's binary mesh in two dimensions, quadrilaterals, a labelled zone for each side: Neko",
            cells=("quad",),
        ),
        MeshFormat(
            name="specfem",
            suffix=".specfem.zip",
            media_type="application/x-specfem2d+zip",
            description="zip of mesh_file, nodes_coords_file, materials_file, free_surface_file and"
            " absorbing_surface_file, quadrilaterals: SPECFEM2D",
            cells=("quad",),
            second_order=True,
        ),
        MeshFormat(
            name="p3d",
            suffix=".p3d.zip",
            media_type="application/x-plot3d+zip",
            description="zip of mesh.xyz, a Plot3D grid of all blocks as text, and mesh.nmf, the neutral map file with"
            " interfaces and sides, quadrilaterals: codes for structured blocks, PyVista",
            cells=("quad",),
        ),
        MeshFormat(
            name="foam",
            suffix=".foam.zip",
            media_type="application/x-openfoam+zip",
            description="zip of constant/polyMesh, one cell thick, with a patch for each side, and"
            " frontAndBack of type empty: OpenFOAM",
        ),
        MeshFormat(
            name="npz",
            suffix=".npz",
            media_type="application/x-npz",
            description="NumPy arrays x, y, u, cells, q_eq, subdomain and the edges of the sides",
        ),
    )
}
