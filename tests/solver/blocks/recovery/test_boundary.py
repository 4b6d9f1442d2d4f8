"""The boundary: sides in their order, corners by angle, name and place, and nodes that lie at the same place."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.recovery.boundary import Boundary, Corner, with_places
from equimesh.blocks.recovery.half_edges import HalfEdges
from equimesh.errors import InputError
from equimesh.numerics.types import IntArray
from solver.blocks.recovery.meshes import Arrays, boundary_of, grid, ring, without


def of(mesh: Arrays, sides: dict[str, IntArray] | None = None, **settings: object) -> Boundary:
    points, cells = mesh
    return Boundary.of(points, HalfEdges.of(points, cells), sides or {}, **settings)  # type: ignore[arg-type]


def test_sides_without_a_name_go_from_corner_to_corner() -> None:
    found = of(grid(3, 2))
    assert [len(edges) for edges in found.sides.values()] == [3, 2, 3, 2]
    assert list(found.sides) == ["side_1", "side_2", "side_3", "side_4"]
    assert found.corners.tolist() == [0, 2, 9, 11]
    for edges in found.sides.values():
        np.testing.assert_array_equal(edges[1:, 0], edges[:-1, 1])


def test_named_sides_in_order_stay_as_they_are_and_others_are_ordered_and_turned() -> None:
    mesh = grid(4, 3)
    ordered = {name: edges for name, edges in of(mesh).sides.items() if name != "side_3"}
    named = {"low": ordered["side_1"], "walls": np.concatenate([ordered["side_4"], ordered["side_2"]])}
    found = of(mesh, named).sides
    assert list(found) == ["low", "walls", "side_1"]
    for name, edges in named.items():
        np.testing.assert_array_equal(found[name], edges)
    random = np.random.default_rng(4)
    mixed = {name: random.permutation(edges)[:, ::-1] for name, edges in named.items()}
    for name, edges in of(mesh, mixed).sides.items():
        assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge) for edge in found[name].tolist()}
    np.testing.assert_array_equal(of(mesh, mixed).sides["low"], found["low"])


def test_a_closed_side_begins_with_its_first_edge() -> None:
    mesh = ring(14, 2)
    outer = [edge for edge in boundary_of(mesh).tolist() if edge[0] % 3 == 2]
    turned = np.array(outer[5:] + outer[:5])
    found = of(mesh, {"far": turned})
    assert found.sides["far"].tolist() == turned.tolist()
    assert [line.is_closed for line in found.lines] == [True, True]
    assert len(found.corners) == 0


def test_ends_of_sides_stay() -> None:
    mesh = grid(6, 1)
    low = of(mesh).sides["side_1"]
    found = of(mesh, {"inlet": low[:2], "wall": low[2:]})
    assert 4 in found.corners
    assert [len(line.nodes) for line in found.lines] == [3, 5, 2, 7, 2]


@pytest.mark.parametrize(("height", "corner"), [(0.0, False), (0.03, True), (0.5, True)])
def test_a_small_turn_is_a_corner_where_it_stands_alone(height: float, corner: bool) -> None:
    points, cells = grid(8, 2)
    points = points.copy()
    points[:, 1] += height * np.maximum(0.0, points[:, 0] - 0.5) * (1 - points[:, 1])
    assert (12 in of((points, cells)).corners) == corner
    assert 12 not in of((points, cells), corner_angle=40.0).corners
    assert 12 in of((points, cells), corner_angle=40.0, corners=[12]).corners
    assert 12 in of((points, cells), corner_angle=180.0, corners=[(0.51, -0.2)]).corners


@pytest.mark.parametrize(
    ("before", "after", "corner"),
    [(1.19, 1.19, True), (1.21, 0.0, False), (0.0, 1.21, False), (-1.21, 0.0, False), (0.0, 0.0, True)],
)
def test_a_small_turn_is_a_corner_by_its_ratio_to_those_beside_it(before: float, after: float, corner: bool) -> None:
    points, cells = grid(8, 2)
    ways = np.radians(np.cumsum([0, 0, 0, before, 6.0, after, 0, 0]))  # of the edges of the lower side; 5 times 1.2
    low = np.concatenate([[[0.0, 0.0]], np.cumsum(np.column_stack([np.cos(ways), np.sin(ways)]), axis=0)]) / 8
    bent = np.concatenate([low[:, None] + np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 1.0]])]).reshape(-1, 2)
    assert points.shape == bent.shape
    assert (12 in of((bent, cells)).corners) == corner


def test_a_coarse_circle_has_no_corners() -> None:
    assert len(of(ring(13, 1)).corners) == 0
    assert len(of(ring(13, 1), corner_angle=10.0).corners) == 26


@pytest.mark.parametrize(
    ("sides", "told"),
    [
        (
            {"mid": [[4, 7]]},
            "'mid' has the edge between the nodes 4 and 7 near (0.5, 0.5), which is not on the boundary",
        ),
        (
            {"a": [[0, 3]], "b": [[3, 0]]},
            "the edge between the nodes 3 and 0 near (0.166667, 0) belongs to the sides 'a' and 'b'",
        ),
        ({"a": np.empty((0, 2), int)}, "the side 'a' has no edges"),
    ],
)
def test_wrong_sides_are_named(sides: dict[str, object], told: str) -> None:
    with pytest.raises(InputError) as caught:
        of(grid(3, 2), {name: np.array(edges) for name, edges in sides.items()})
    assert told in caught.value.message


@pytest.mark.parametrize("corner", [4, 99, -1, (1.0, 2.0, 3.0), (float("nan"), 0.0), True])
def test_wrong_corners_are_named(corner: Corner) -> None:
    with pytest.raises(InputError, match=r"corners\[1\]"):
        of(grid(2, 2), corners=[0, corner])


def test_corners_by_the_names_of_points() -> None:
    assert with_places(["te", 3, (1.0, 2.0)], {"te": 7}) == [7, 3, (1.0, 2.0)]
    with pytest.raises(InputError, match=r"corners\[1\] = 'le' is no named point of the file: there are te"):
        with_places(["te", "le"], {"te": 7})


def test_nodes_at_the_same_place_are_named() -> None:
    points, cells = without(grid(4, 4), (0.25, 0.75, 0.25, 0.75))
    hole = np.flatnonzero((np.abs(points - 0.5) < 0.3).all(axis=1))
    shut = points.copy()
    shut[hole, 1] = 0.5 + 1e-13 * (points[hole, 1] - 0.5)
    with pytest.raises(InputError) as caught:
        of((shut, cells))
    assert "lie at the same place (" in caught.value.message
    assert "Remove duplicate nodes" in caught.value.message


def test_a_node_in_the_middle_of_an_edge_is_named() -> None:
    points, cells = grid(2, 2)
    inner = np.array([[0.5, 0.25], [1.0, 0.25]])  # the lower right cell is cut, its neighbour is not
    cut = np.array([cells[0], cells[1], cells[3], [3, 6, 10, 9], [9, 10, 7, 4]])
    with pytest.raises(InputError, match=r"in the middle of (its|the) edge"):
        of((np.concatenate([points, inner]), cut))


def test_a_corner_that_is_a_word_is_refused_with_its_entry() -> None:
    with pytest.raises(InputError, match=r"corners\[1\] = 'tip': give the number of a node, or its place"):
        of(grid(3, 2), corners=[0, "tip"])
