"""Abaqus input files, read back by meshio, CalculiX and p4est."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import meshio
import numpy as np
import pytest

import equimesh as em
from equimesh.io import write_mesh
from equimesh.io.abaqus import MAX_WIDTH, abaqus_text, number
from equimesh.io.formats import CELLS, Cells
from equimesh.meshes.mesh_data import MeshData

NEEDED = "EQUIMESH_TEST_SOLVERS_NEEDED" in os.environ
SIDES = ("left", "right", "bottom", "top")
HEAT = """*INCLUDE, INPUT={file}
*MATERIAL, NAME=one
*CONDUCTIVITY
1.
*SOLID SECTION, ELSET=domain, MATERIAL=one
1.
*STEP
*HEAT TRANSFER, STEADY STATE
*BOUNDARY
left, 11, 11, 0.
*FILM
{film}
*NODE PRINT, NSET=bottom
NT
*END STEP
"""
READER = """
#include <p4est_connectivity.h>
#include <stdio.h>
int main(int argc, char **argv) {
  p4est_connectivity_t *mesh = p4est_connectivity_read_inp(argv[1]);
  if (!mesh) return 2;
  int walls = 0;
  for (int tree = 0; tree < mesh->num_trees; tree++)
    for (int face = 0; face < 4; face++)
      walls += mesh->tree_to_tree[4 * tree + face] == tree && mesh->tree_to_face[4 * tree + face] == face;
  printf("%d %d %d %d", (int) mesh->num_trees, (int) mesh->num_vertices, p4est_connectivity_is_valid(mesh), walls);
  return 0;
}
"""


@pytest.fixture(scope="module")
def data() -> MeshData:
    u = em.Expression("tanh(10*(x + y/2 - 0.75))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=9, n_eta=7))
    return em.solve(problem, em.Schwarz(subdomains=(2, 1))).data()


@pytest.mark.parametrize("kind", CELLS)
def test_meshio_reads_cells_sides_and_subdomains(tmp_path: Path, data: MeshData, kind: Cells) -> None:
    (path,) = write_mesh(tmp_path / "mesh.inp", data, cells=kind)
    found = meshio.read(path)
    np.testing.assert_array_equal(found.points[:, :2], data.mesh.points)
    cells = data.triangles() if kind == "triangle" else data.mesh.cells
    np.testing.assert_array_equal(found.cells_dict[kind], cells)
    assert set(found.point_sets) == set(SIDES)
    for side in SIDES:
        np.testing.assert_array_equal(np.sort(found.point_sets[side]), np.unique(data.mesh.sides[side]))
    parts = np.repeat(data.subdomain.ravel(), 2 if kind == "triangle" else 1)
    for part in (0, 1):
        np.testing.assert_array_equal(found.cell_sets[f"subdomain_{part + 1}"][0], np.flatnonzero(parts == part))


@pytest.mark.parametrize("kind", CELLS)
def test_surfaces_are_the_edges_of_sides(data: MeshData, kind: Cells) -> None:
    cells = data.triangles() if kind == "triangle" else data.mesh.cells
    text = abaqus_text(data.mesh.points, cells, data.mesh.sides, subdomain=np.zeros(len(cells), dtype=np.int64))
    assert "subdomain" not in text
    for side, edges in data.mesh.sides.items():
        rows = text.split(f"NAME={side}_edges, TYPE=ELEMENT\n")[1].split("*")[0].splitlines()
        found = [tuple(map(int, re.fullmatch(r"(\d+), S(\d)", row).groups())) for row in rows]  # type: ignore[union-attr]
        pairs = [{cells[cell - 1, face - 1], cells[cell - 1, face % cells.shape[1]]} for cell, face in found]
        assert pairs == [set(edge) for edge in edges.tolist()]


def test_a_side_called_domain_leaves_the_name_to_the_cells(data: MeshData) -> None:
    sides = {"domain": data.mesh.sides["left"], "hot wall": data.mesh.sides["right"]}
    text = abaqus_text(data.mesh.points, data.mesh.cells, sides, subdomain=data.subdomain.ravel())
    assert re.findall(r"^\*NSET,NSET=(.*)$", text, re.MULTILINE) == ["domain_2", "hot_wall"]
    assert "type=CPS4, ELSET=domain\n" in text


def test_names_differ_for_readers_that_see_no_case_and_80_characters(data: MeshData) -> None:
    left, right = data.mesh.sides["left"], data.mesh.sides["right"]
    sides = {"Wall": left, "wall": right, "a" * 90: left, "a" * 91: right, "a" * 74: left}
    text = abaqus_text(data.mesh.points, data.mesh.cells, sides, subdomain=data.subdomain.ravel())
    nodes = re.findall(r"^\*NSET,NSET=(.*)$", text, re.MULTILINE)
    assert nodes == ["Wall", "wall_2", "a" * 72 + "_2", "a" * 72 + "_3", "a" * 74]
    assert re.findall(r"NAME=(.*), TYPE", text) == [f"{name}_edges" for name in nodes]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        (-0.08333333367782755, "-0.08333333367782755"),
        (-1.2345678901234567e-05, "-1.2345678901235e-05"),
        (-1.2345678901234567e-305, "-1.234567890123e-305"),
        (12345678.901234567, "12345678.901234567"),
    ],
)
def test_numbers_fit_the_columns_of_readers(value: float, text: str) -> None:
    assert number(value) == text
    assert len(text) <= MAX_WIDTH


@pytest.mark.skipif(shutil.which("ccx") is None and not NEEDED, reason="CalculiX is not installed")
@pytest.mark.parametrize("kind", CELLS)
def test_calculix_solves_on_it(tmp_path: Path, data: MeshData, kind: Cells) -> None:
    """Heat flows from a film of temperature 2 on the right to the left, which is at 0: the solution is T = x."""
    (path,) = write_mesh(tmp_path / "mesh.inp", data, cells=kind)
    rows = path.read_text().split("NAME=right_edges, TYPE=ELEMENT\n")[1].split("*")[0].splitlines()
    film = "\n".join(f"{row.replace('S', 'F')}, 2., 1." for row in rows)
    (tmp_path / "heat.inp").write_text(HEAT.format(file=path.name, film=film))
    done = subprocess.run(["ccx", "heat"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert "Job finished" in done.stdout, done.stdout[-2000:]
    table = np.loadtxt((tmp_path / "heat.dat").read_text().splitlines(), skiprows=3)
    bottom = np.unique(data.mesh.sides["bottom"])
    np.testing.assert_array_equal(table[:, 0], bottom + 1)
    np.testing.assert_allclose(table[:, 1], data.mesh.points[bottom, 0], atol=1e-6)


@pytest.mark.skipif(
    (shutil.which("mpicc") is None or not Path("/usr/include/p4est.h").exists()) and not NEEDED,
    reason="p4est is not installed",
)
def test_p4est_reads_a_valid_connectivity(tmp_path: Path, data: MeshData) -> None:
    (path,) = write_mesh(tmp_path / "mesh.inp", data)
    (tmp_path / "reader.c").write_text(READER)
    subprocess.run(["mpicc", "reader.c", "-o", "reader", "-lp4est", "-lsc"], cwd=tmp_path, timeout=120, check=True)
    done = subprocess.run(["./reader", str(path)], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True)
    trees, vertices, is_valid, walls = map(int, done.stdout.splitlines()[-1].split())
    assert (trees, vertices) == (data.mesh.cells.shape[0], len(data.mesh.points))
    assert is_valid
    assert walls == sum(len(edges) for edges in data.mesh.sides.values())
