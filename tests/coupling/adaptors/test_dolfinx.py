"""dolfinx: what the adaptor hands over, to releases of both interfaces. The real one runs in tests/solvers."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from equimesh_coupling import BadValues, MeshParts, MissingLibrary, element_points
from equimesh_coupling.adaptors.dolfinx import mesh_of, nodal_values, placed_values
from equimesh_coupling.elements import at_elements

FIRST = SimpleNamespace(rank=0)
SECOND = SimpleNamespace(rank=1)


class Release:
    """Modules with the functions of one release, which keep what they are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, old: bool) -> None:
        self.given: dict[str, Any] = {}
        self.topology = SimpleNamespace(create_connectivity=lambda *_: None)
        modules = {name: ModuleType(name) for name in ("dolfinx", "dolfinx.mesh", "dolfinx.graph", "dolfinx.io", "ufl")}
        mesh: Any = modules["dolfinx.mesh"]
        mesh.create_mesh = self.create_old if old else self.create_new
        mesh.meshtags_from_entities = lambda _mesh, _dim, lists, values: SimpleNamespace(lists=lists, values=values)
        graph: Any = modules["dolfinx.graph"]
        setattr(graph, "create_adjacencylist" if old else "adjacencylist", lambda nodes: nodes)
        io: Any = modules["dolfinx.io"]
        io.distribute_entity_data = self.distribute_inner if old else self.distribute
        ufl: Any = modules["ufl"]
        ufl.Mesh = lambda element: ("ufl", element)
        ufl.VectorElement = lambda family, kind, degree: (family, kind, degree)
        if not old:
            modules["basix"] = ModuleType("basix")
            basix: Any = ModuleType("basix.ufl")
            basix.element = lambda family, kind, degree, shape: (family, kind, degree, shape)
            modules["basix.ufl"] = basix
        for name in ("basix", "basix.ufl"):
            monkeypatch.setitem(sys.modules, name, None)
        for name, module in modules.items():
            monkeypatch.setitem(sys.modules, name, module)

    def create_old(self, _comm: Any, cells: Any, x: Any, domain: Any) -> Any:
        self.given |= {"cells": cells, "x": x, "element": domain}
        return SimpleNamespace(topology=self.topology, _mesh="inner")

    def create_new(self, _comm: Any, cells: Any, e: Any, x: Any) -> Any:
        self.given |= {"cells": cells, "x": x, "element": e}
        return SimpleNamespace(topology=self.topology)

    def distribute(self, _mesh: Any, _dim: int, edges: Any, tags: Any) -> Any:
        self.given |= {"edges": edges, "tags": tags}
        return edges, tags

    def distribute_inner(self, mesh: Any, dim: int, edges: Any, tags: Any) -> Any:
        if mesh != "inner":
            raise TypeError("incompatible function arguments")
        return self.distribute(mesh, dim, edges, tags)


@pytest.mark.parametrize("old", [True, False], ids=["0.5", "0.10"])
def test_both_interfaces_get_the_same_arrays(old: bool, parts: MeshParts, monkeypatch: pytest.MonkeyPatch) -> None:
    release = Release(monkeypatch, old=old)
    mesh, sides = mesh_of(parts, FIRST)
    kind = "triangle" if parts.is_triangular else "quadrilateral"
    assert release.given["element"] == (("ufl", ("Lagrange", kind, 1)) if old else ("Lagrange", kind, 1, (2,)))
    order = [0, 1, 2] if parts.is_triangular else [0, 1, 3, 2]
    assert np.array_equal(release.given["cells"], parts.cells[:, order])
    assert np.array_equal(release.given["x"], parts.points)
    for number, edges in enumerate(parts.sides.values(), start=1):
        assert np.array_equal(release.given["edges"][sides.values == number], edges)
    assert (sides.values.dtype, release.given["edges"].dtype) == (np.int32, np.int64)
    assert sides.name == "sides"
    assert mesh.topology is release.topology


def test_other_processes_give_nothing(parts: MeshParts, monkeypatch: pytest.MonkeyPatch) -> None:
    release = Release(monkeypatch, old=False)
    mesh_of(parts, SECOND)
    shapes = {name: release.given[name].shape for name in ("cells", "x", "edges", "tags")}
    assert shapes == {"cells": (0, parts.cells.shape[1]), "x": (0, 2), "edges": (0, 2), "tags": (0,)}


def test_a_missing_library_is_named(parts: MeshParts, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dolfinx", None)
    with pytest.raises(MissingLibrary, match=r"this needs fenics-dolfinx.*conda install -c conda-forge"):
        mesh_of(parts, FIRST)


def function(parts: MeshParts, values: Any, turn: Any) -> Any:
    """A function of order 1 on cells whose nodes are renumbered by ``turn``."""
    numbers = np.argsort(turn)
    dofs = SimpleNamespace(list=numbers[parts.cells])
    geometry = SimpleNamespace(input_global_indices=turn, dofmap=numbers[parts.cells])
    space = SimpleNamespace(mesh=SimpleNamespace(geometry=geometry), dofmap=dofs)
    return SimpleNamespace(function_space=space, x=SimpleNamespace(array=values))


def test_values_come_back_in_our_order(parts: MeshParts) -> None:
    turn = np.random.default_rng(1).permutation(len(parts.points))
    ours = parts.points @ [1.0, 2.0]
    assert np.array_equal(nodal_values(function(parts, ours[turn], turn), parts), ours.reshape(parts.shape))
    with pytest.raises(BadValues, match=f"has 3 values here, and this mesh {len(turn)} nodes"):
        nodal_values(function(parts, np.zeros(3), turn), parts)


@pytest.mark.parametrize("old", [False, True])
def test_values_of_order_2_come_with_their_places(parts: MeshParts, old: bool) -> None:
    kind, points = "quadrilateral", element_points(parts, 2)
    if parts.is_triangular:
        kind, points = "triangle", element_points(parts, 2, "triangle")
    order = np.random.default_rng(2).permutation(len(points))
    element = SimpleNamespace(degree=(lambda: 2) if old else 2)
    space = SimpleNamespace(
        ufl_element=lambda: element,
        tabulate_dof_coordinates=lambda: np.pad(points[order], ((0, 0), (0, 1))),
        mesh=SimpleNamespace(topology=SimpleNamespace(cell_name=lambda: kind)),
    )
    found = placed_values(SimpleNamespace(function_space=space, x=SimpleNamespace(array=points[order, 0])), parts)
    assert found is not None
    assert np.array_equal(at_elements(found, parts).ravel(), points[:, 0])
    element.degree = 3 if parts.is_triangular else 1
    assert placed_values(SimpleNamespace(function_space=space, x=SimpleNamespace(array=points[:, 0])), parts) is None
