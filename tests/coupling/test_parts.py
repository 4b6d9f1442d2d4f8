"""The arrays of a mesh for other libraries, and the methods that hand it over."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from equimesh import Mesh
from equimesh_coupling import BadValues, Coupled, MeshParts, MissingLibrary, OldLibrary
from equimesh_coupling.parts import CUTS, SIDES, TAGS, better_cuts, corner_cuts, quads_of, triangles_of


def doubled_areas(parts: MeshParts) -> np.ndarray:
    """Twice the signed area of each cell, by the shoelace formula."""
    x, y = parts.points[parts.cells, 0], parts.points[parts.cells, 1]
    return (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)


def test_cells_are_counter_clockwise_and_fill_the_same_area(quads: MeshParts, triangles: MeshParts) -> None:
    assert doubled_areas(quads).min() > 0
    assert doubled_areas(triangles).min() > 0
    assert np.allclose(doubled_areas(triangles).reshape(-1, 2).sum(axis=1), doubled_areas(quads))
    assert not quads.is_triangular
    assert triangles.is_triangular


def test_the_sides_are_edges_of_the_cells_with_the_domain_on_their_left(parts: MeshParts) -> None:
    assert (*parts.sides,) == SIDES == (*TAGS,)
    ahead = np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=2).reshape(-1, 2)
    directed = set(map(tuple, ahead.tolist()))
    number = np.arange(35).reshape(7, 5)
    nodes = {"left": number[0], "right": number[-1], "bottom": number[:, 0], "top": number[:, -1]}
    for side, edges in parts.sides.items():
        assert set(map(tuple, edges.tolist())) <= directed
        assert {*edges.ravel().tolist()} == {*nodes[side].tolist()}
    assert list(TAGS.values()) == [1, 2, 3, 4]


def test_both_kinds_of_cells_are_made_of_each_other(quads: MeshParts, triangles: MeshParts) -> None:
    assert quads.mesh_parts("quad") is quads.mesh_parts() is quads
    assert np.array_equal(quads.mesh_parts("triangle").cells, triangles.cells)
    assert np.array_equal(triangles.mesh_parts("quad").cells, quads.cells)
    with pytest.raises(BadValues, match="unknown kind of cells 'hexagon': choose quad or triangle"):
        quads.mesh_parts("hexagon")  # type: ignore[arg-type]


# Cuts of quadrilaterals: the diagonal that leaves the larger smallest angle.


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def angles(triangle: np.ndarray) -> list[float]:
    """The signed angles, in degrees, from sines and cosines of plain vectors."""
    found = []
    for k in range(3):
        a, b = triangle[(k + 1) % 3] - triangle[k], triangle[(k + 2) % 3] - triangle[k]
        found.append(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))
    return found


def test_the_diagonal_with_the_larger_smallest_angle_is_taken() -> None:
    corners = SQUARE + np.random.default_rng(1).uniform(-0.4, 0.4, (200, 4, 2))
    chosen = better_cuts(corners)
    assert set(chosen) == {0, 1}
    for cell, cut in zip(corners, chosen, strict=True):
        smallest = [min(min(angles(cell[list(part)])) for part in parts) for parts in CUTS]
        assert smallest[cut] == max(smallest)


def test_a_dent_is_cut_from_its_corner() -> None:
    # One corner is pushed inwards: only the cut through it leaves two positive triangles.
    for dented in range(4):
        cell = SQUARE.copy()
        cell[dented] = 0.55 * SQUARE[(dented + 2) % 4] + 0.45 * SQUARE[dented]
        assert better_cuts(cell[None])[0] == dented % 2
        assert all(min(angles(cell[list(part)])) > 0 for part in CUTS[dented % 2])


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
def test_equal_diagonals_give_the_first_cut(turn: float) -> None:
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    assert better_cuts((SQUARE @ matrix)[None]).tolist() == [0]


def corner_cells() -> np.ndarray:
    """Six cells of a 3 x 2 grid, all cut better from corner 1 to 3 or, where the row says so, from 0 to 2."""
    wide = SQUARE @ np.array([[1.0, 0.4], [0.4, 1.0]])  # corners 0 and 2 far apart: 1 to 3 is better
    return np.stack([wide] * 6)


def test_cells_at_the_corners_are_cut_through_the_corner() -> None:
    cells, through = corner_cells(), corner_cuts((3, 2))
    assert through == {0: 0, 1: 1, 4: 1, 5: 0}
    assert better_cuts(cells).tolist() == [1] * 6
    assert better_cuts(cells, through).tolist() == [0, 1, 1, 1, 1, 0]
    mirrored = cells[:, ::-1] * [-1.0, 1.0]
    assert better_cuts(mirrored[:, [3, 0, 1, 2]], through).tolist() == [0, 1, 1, 1, 1, 0]


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (7, 4)])
def test_the_corners_of_the_grid_are_in_two_triangles(shape: tuple[int, int]) -> None:
    number = np.arange((shape[0] + 1) * (shape[1] + 1)).reshape(shape[0] + 1, shape[1] + 1)
    ends = (number[0, 0], number[-1, 0], number[-1, -1], number[0, -1])
    parts = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    cells = np.stack([part.ravel() for part in parts], axis=1)
    for cell, cut in corner_cuts(shape).items():
        (end,) = {*cells[cell]} & {*ends}
        assert all(end in cells[cell][list(part)] for part in CUTS[cut])
    assert len(corner_cuts(shape)) == 4


def test_a_cut_that_inverts_a_triangle_is_not_taken() -> None:
    cell = SQUARE.copy()
    cell[0] = [0.55, 0.55]
    assert better_cuts(cell[None], {0: 1}).tolist() == [0]


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (4, 1)])
def test_grids_one_cell_wide_have_no_such_cells(shape: tuple[int, int]) -> None:
    assert corner_cuts(shape) == {}


def test_the_triangles_of_a_grid_hold_each_corner_twice() -> None:
    xi, eta = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 4), indexing="ij")
    points = np.column_stack([(xi + 0.3 * eta).ravel(), eta.ravel()])  # sheared: elsewhere the other diagonal is better
    triangles = triangles_of(points, (5, 4))
    assert triangles.shape == (24, 3)
    assert [np.count_nonzero(triangles == end) for end in (0, 3, 16, 19)] == [2, 2, 2, 2]
    a, b, c = points[triangles].transpose(1, 0, 2)
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert doubled.min() > 0
    assert abs(doubled.reshape(-1, 2).sum(axis=1) - 1 / 6).max() < 1e-15
    assert {*map(frozenset, quads_of((5, 4)).tolist())} == {
        frozenset(pair.ravel()) for pair in triangles.reshape(-1, 6)
    }


# By the name of a method: the module that it imports, the package of its version, and how the package is installed.
LIBRARIES = {
    "skfem": ("skfem", "scikit-fem", "pip install 'scikit-fem>=9'"),
    "pyvista": ("pyvista", "pyvista", "pip install 'pyvista>=0.40'"),
    "fipy": ("fipy", "fipy", "pip install 'fipy>=3.4.5'"),
    "mfem": ("mfem.ser", "mfem", "pip install 'mfem>=4.7'"),
    "ngsolve": ("ngsolve", "ngsolve", "pip install 'ngsolve>=6.2.2302'"),
    "sfepy": ("sfepy.discrete.fem", "sfepy", "pip install 'sfepy>=2021.1'"),
    "dolfinx": ("dolfinx", "fenics-dolfinx", "apt-get install python3-dolfinx"),
    "dmplex": ("petsc4py.PETSc", "petsc4py", "apt-get install python3-petsc4py"),
}


def hand_over(mesh: Coupled, name: str) -> Any:
    """Call a method, where it takes one with a communicator of one process."""
    method = getattr(mesh, f"to_{name}")
    return method(SimpleNamespace(rank=0, size=1)) if name in ("dolfinx", "dmplex") else method()


def test_every_library_is_here() -> None:
    assert {name.removeprefix("to_") for name in vars(Coupled) if name.startswith("to_")} == {*LIBRARIES}


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_missing_library_is_named_with_its_package(name: str, mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    module, package, install = LIBRARIES[name]
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingLibrary) as caught:
        hand_over(mesh, name)
    assert str(caught.value).startswith(f"this needs {package}, which is not installed: {install}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", LIBRARIES)
def test_an_old_library_is_named_with_both_versions(name: str, mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    module, package, install = LIBRARIES[name]
    for part in (module.partition(".")[0], module):
        monkeypatch.setitem(sys.modules, part, ModuleType(part))
    monkeypatch.setattr(metadata, "version", {package: "0.1", "dolfinx": "0.1"}.__getitem__)
    with pytest.raises(OldLibrary) as caught:
        hand_over(mesh, name)
    assert str(caught.value).startswith(f"this needs {package} ")
    assert f" or later, and 0.1 is installed: {install}" in str(caught.value)


def test_nothing_is_imported_before_it_is_needed() -> None:
    roots = ["scipy", "meshio", "netgen", "ufl", *(module.partition(".")[0] for module, _, _ in LIBRARIES.values())]
    code = f"import sys, equimesh_coupling; print([name for name in {roots!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout == "[]\n"
