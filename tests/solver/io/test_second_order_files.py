"""Files of cells of second order, read back by meshio, scikit-fem, CalculiX, Gmsh and PyVista."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
import skfem
from skfem.models.poisson import laplace

import equimesh as em
from equimesh.errors import InputError
from equimesh.fields.curved_sides import curved_edges
from equimesh.io.formats import CELLS, FORMATS, Cells
from equimesh.io.write import write_mesh
from equimesh.meshes.second_order import SecondOrderMesh
from equimesh_coupling.recovery import edge_numbers

NEEDED = "EQUIMESH_TEST_SOLVERS_NEEDED" in os.environ
HEAT = """*INCLUDE, INPUT=mesh.inp
*MATERIAL, NAME=one
*CONDUCTIVITY
1.
*SOLID SECTION, ELSET=domain, MATERIAL=one
1.
*STEP
*HEAT TRANSFER, STEADY STATE
*BOUNDARY
left, 11, 11, 0.
right, 11, 11, 1.
*NODE PRINT, NSET=bottom
NT
*END STEP
"""
WIDTHS = {"left": 6, "right": 6, "bottom": 8, "top": 8}
"""The edges of each side."""


@pytest.fixture(scope="module")
def solution() -> em.Solution:
    """A quarter of a ring."""
    u = em.Expression("tanh(5*(x + y - 2))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=9, n_eta=7), domain=em.AnnulusSector())
    return em.solve(problem)


@pytest.fixture(scope="module")
def second(solution: em.Solution) -> SecondOrderMesh:
    return SecondOrderMesh.of(
        solution.mesh.points, solution.mesh.cells, curved_edges(solution.mesh, solution.problem.domain)
    )


def written(folder: Path, solution: em.Solution, suffix: str, kind: Cells = "quad") -> Path:
    return solution.write(folder / f"mesh.{suffix}", cells=kind, order=2)[0]


@pytest.mark.parametrize("kind", CELLS)
@pytest.mark.parametrize("suffix", ["vtu", "msh"])
def test_meshio_reads_nodes_cells_sides_and_data(
    tmp_path: Path, solution: em.Solution, second: SecondOrderMesh, suffix: str, kind: Cells
) -> None:
    found = meshio.read(written(tmp_path, solution, suffix, kind))
    np.testing.assert_array_equal(found.points[:, :2], second.points)
    is_quad = kind == "quad"
    cells = second.cells if is_quad else second.triangles(solution.mesh.triangles())
    np.testing.assert_array_equal(found.cells_dict["quad9" if is_quad else "triangle6"], cells)
    np.testing.assert_array_equal(found.point_data["u"], second.at_nodes(solution.u.ravel()))
    if suffix == "msh":
        edges = np.concatenate([second.edges(edges) for edges in solution.mesh.sides.values()])
        np.testing.assert_array_equal(found.cells_dict["line3"], edges)
        numbers = found.cell_data_dict["gmsh:physical"]["line3"]
        assert {name: int((numbers == found.field_data[name][0]).sum()) for name in WIDTHS} == WIDTHS
    radius = np.hypot(*second.points.T)
    on_sides = {name: second.edges(edges)[:, 2] for name, edges in solution.mesh.sides.items()}
    np.testing.assert_allclose(radius[on_sides["left"]], 1.0, rtol=1e-14)
    np.testing.assert_allclose(radius[on_sides["right"]], 2.0, rtol=1e-14)


@pytest.mark.parametrize("kind", CELLS)
def test_a_file_in_hdf5_has_nodes_cells_and_the_sides_of_the_nodes(
    tmp_path: Path, solution: em.Solution, second: SecondOrderMesh, kind: Cells
) -> None:
    with h5py.File(written(tmp_path, solution, "hdf", kind)) as file:
        root = file["VTKHDF"]
        assert root.attrs["Type"] == b"UnstructuredGrid"
        is_quad = kind == "quad"
        cells = second.cells if is_quad else second.triangles(solution.mesh.triangles())
        counts = [root[f"NumberOf{name}"][0] for name in ("Points", "Cells", "ConnectivityIds")]
        assert counts == [len(second.points), len(cells), cells.size]
        np.testing.assert_array_equal(root["Points"][:, :2], second.points)
        np.testing.assert_array_equal(root["Connectivity"][:].reshape(cells.shape), cells)
        np.testing.assert_array_equal(np.diff(root["Offsets"][:]), cells.shape[1])
        assert set(root["Types"][:]) == {28 if is_quad else 22}
        np.testing.assert_array_equal(root["PointData/u"][:], second.at_nodes(solution.u.ravel()))
        assert root["CellData/Q_eq"].shape == (len(cells),)
        middles = second.edges(solution.mesh.sides["right"])[:, 2]
        assert set(root["PointData/node_groups"][:][middles]) == {2}


def test_blocks_have_the_edges_of_their_sides_in_a_vtu_file(tmp_path: Path) -> None:
    domain = em.Blocks.of(
        {
            "vertices": {"i": [1, 0], "o": [2, 0]},
            "curves": {"inner": {"circle": {"radius": 1}}, "outer": {"circle": {"radius": 2}}},
            "edges": [{"from": "i", "to": "i", "on": "inner"}, {"from": "o", "to": "o", "on": "outer"}],
            "blocks": [{"corners": ["i", "o", "o", "i"], "cells": [3, 12]}],
            "sides": {"body": [["i", "i"]]},
        }
    )
    solution = em.solve(em.Problem(monitor=em.LeastError(u=em.Expression("exp(-x*x)")), domain=domain))
    found = meshio.read(written(tmp_path, solution, "vtu"))
    edges = found.field_data["sides/body"].reshape(-1, 3)
    np.testing.assert_array_equal(edges[:, :2], solution.mesh.sides["body"])
    np.testing.assert_allclose(np.hypot(*found.points[edges.ravel(), :2].T), 1.0, rtol=1e-12)


@pytest.mark.parametrize("suffix", ["msh", "inp"])
def test_closed_lines_have_one_node_at_the_seam_in_files(tmp_path: Path, suffix: str) -> None:
    u = em.Expression("x")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=4, n_eta=9), domain=em.AnnulusSector(closed=True))
    text = written(tmp_path, em.solve(problem), suffix).read_text()
    nodes, edges, cells = 4 * 8, 3 * 8 + 4 * 8, 3 * 8
    if suffix == "msh":
        assert f"$Nodes\n{nodes + edges + cells}\n" in text
    else:
        assert f"\n{nodes + edges}, " in text  # the centres are left out
        assert f"\n{nodes + edges + 1}, " not in text
        assert "type=CPS8, ELSET=domain\n" in text


def test_periodic_sides_have_pairs_of_middles_too(tmp_path: Path) -> None:
    domain = em.Rectangle(x=(0.0, 2.0), periodic="x")
    problem = em.Problem(
        monitor=em.ArcLength(u=em.Expression("sin(pi*x)")), grid=em.Grid(n_xi=5, n_eta=4), domain=domain
    )
    rows = written(tmp_path, em.solve(problem), "msh").read_text().split("$Periodic\n")[1].splitlines()
    assert rows[3] == "7"  # four nodes and three middles
    points = meshio.read(tmp_path / "mesh.msh").points
    pairs = np.array([row.split() for row in rows[4:11]], dtype=int) - 1
    np.testing.assert_allclose(abs(points[pairs[:, 0]] - points[pairs[:, 1]]), [[2.0, 0.0, 0.0]] * 7, atol=1e-14)


@pytest.mark.parametrize("kind", CELLS)
def test_scikit_fem_solves_on_curved_cells_far_more_exactly(tmp_path: Path, solution: em.Solution, kind: Cells) -> None:
    """log r is harmonic: on straight sides the domain itself is wrong."""
    element = skfem.ElementQuad2() if kind == "quad" else skfem.ElementTriP2()
    errors = []
    for order in (1, 2):
        solution.write(tmp_path / "mesh.msh", cells=kind, order=order)  # type: ignore[arg-type]
        basis = skfem.Basis(skfem.Mesh.load(tmp_path / "mesh.msh"), element)
        radius, facets = np.hypot(*basis.doflocs), basis.mesh.facets.T
        arcs = (edge_numbers(solution.mesh.sides[side], facets) for side in ("left", "right"))
        walls = basis.get_dofs(np.concatenate([*arcs])).flatten()
        given = np.where(radius > 1.5, math.log(2.0), 0.0)
        u = skfem.solve(*skfem.condense(laplace.assemble(basis), x=given, D=walls))
        errors.append(float(np.abs(u - np.log(radius)).max()))
    assert errors[1] < 1e-3
    assert errors[0] > 8.0 * errors[1]


@pytest.mark.skipif(shutil.which("ccx") is None and not NEEDED, reason="CalculiX is not installed")
@pytest.mark.parametrize("kind", CELLS)
def test_calculix_solves_on_it(tmp_path: Path, solution: em.Solution, second: SecondOrderMesh, kind: Cells) -> None:
    """The temperature between 0 and 1 on the two arcs is log r / log 2."""
    written(tmp_path, solution, "inp", kind)
    (tmp_path / "heat.inp").write_text(HEAT)
    done = subprocess.run(["ccx", "heat"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert "Job finished" in done.stdout, done.stdout[-2000:]
    table = np.loadtxt((tmp_path / "heat.dat").read_text().splitlines(), skiprows=3)
    bottom = np.unique(second.edges(solution.mesh.sides["bottom"]))
    np.testing.assert_array_equal(table[:, 0], bottom + 1)
    np.testing.assert_allclose(table[:, 1], np.log2(np.hypot(*second.points[bottom].T)), atol=1e-3)


@pytest.mark.parametrize("kind", CELLS)
def test_gmsh_finds_valid_cells_and_the_area(tmp_path: Path, solution: em.Solution, kind: Cells) -> None:
    gmsh = pytest.importorskip("gmsh")
    path = written(tmp_path, solution, "msh", kind)
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        kinds, (cells,), _ = gmsh.model.mesh.getElements(2)
        assert kinds.tolist() == [10 if kind == "quad" else 9]
        assert gmsh.model.mesh.getElementQualities(cells, "minSJ").min() > 0.1
        area = gmsh.model.mesh.getElementQualities(cells, "volume").sum()
        assert area == pytest.approx(0.75 * math.pi, rel=1e-4)  # 3e-3 with straight sides
        groups = {gmsh.model.getPhysicalName(1, tag): tag for _, tag in gmsh.model.getPhysicalGroups(1)}
        found = {name: len(gmsh.model.mesh.getNodesForPhysicalGroup(1, tag)[0]) for name, tag in groups.items()}
        assert found == {name: 2 * count + 1 for name, count in WIDTHS.items()}
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("kind", CELLS)
def test_pyvista_reads_cells_that_are_not_linear(tmp_path: Path, solution: em.Solution, kind: Cells) -> None:
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(written(tmp_path, solution, "vtu", kind))
    assert set(grid.celltypes.tolist()) == {28 if kind == "quad" else 22}
    assert grid.compute_cell_sizes()["Area"].min() > 0.0


@pytest.mark.parametrize("name", [name for name, form in FORMATS.items() if not form.second_order])
def test_other_formats_refuse_second_order(tmp_path: Path, solution: em.Solution, name: str) -> None:
    with pytest.raises(
        InputError, match=f"a {name} file holds cells of order 1: choose one of vtu, hdf, msh, abaqus"
    ) as error:
        write_mesh(tmp_path / "mesh", solution.data(), format=name, order=2)
    assert error.value.field == "order"


def test_there_is_no_third_order(tmp_path: Path, solution: em.Solution) -> None:
    with pytest.raises(InputError, match="order = 3: cells have order 1, or 2 with curved edges"):
        solution.write(tmp_path / "mesh.vtu", order=3)  # type: ignore[arg-type]
