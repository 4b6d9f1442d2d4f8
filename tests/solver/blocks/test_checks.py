"""Curves that cross themselves, and initial meshes that fold."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.blocks.checks import _pairs_of_cells, check_not_crossing, find_overlap
from equimesh.blocks.curve_entries import Airfoil
from equimesh.blocks.curves import Circle
from equimesh.blocks.spline_curve import SplineCurve
from equimesh.meshes.mesh import Mesh
from equimesh.testing import geometries
from solver.blocks import documents


@pytest.mark.parametrize("curve", [Circle(), Airfoil(digits="0012"), Airfoil(digits="6409")], ids=str)
def test_closed_curves_touch_at_their_begin_only(curve: Circle | Airfoil) -> None:
    check_not_crossing(curve, "curves.foil", "domain.curves.foil")


def test_a_crossing_is_refused_with_its_place() -> None:
    eight = ((0.0, 0.0), (1.0, 1.0), (2.0, 0.0), (1.0, -1.0), (0.0, 1.0), (-0.5, 0.5), (0.0, 0.0))
    with pytest.raises(em.InputError, match=r"curves.foil crosses itself near \(0\.\d+, 0\.\d+\), at t = ") as caught:
        check_not_crossing(SplineCurve(points=eight, closed=True), "curves.foil", "domain.curves.foil")
    assert caught.value.field == "domain.curves.foil"


def test_a_block_that_folds_is_named_with_its_place() -> None:
    document = documents.l_shape()
    document["vertices"]["e"] = [-0.5, 0.2]
    with pytest.raises(em.InputError, match=r"block0 folds at \(.*\), in its cell \(\d, \d\) of 4 x 5: move") as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.blocks[0]"


def test_a_block_that_is_inside_out_is_named() -> None:
    document = {
        "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
        "blocks": [{"corners": ["a", "d", "c", "b"], "cells": [3, 3]}],
    }
    with pytest.raises(em.InputError, match="block0 is inside out: list its corners counter-clockwise"):
        Blocks.of(document)


def around(third: float) -> dict[str, Any]:
    """Blocks that go around in a spiral: the last one ends at the height ``third``, the first one begins at 0 to 1."""
    places = {"a": (0, 0), "b": (3, 0), "c": (3, 3), "d": (0, 3), "i": (1, 1), "j": (2, 1), "k": (2, 2), "l": (1, 2)}
    corners = [["a", "b", "j", "i"], ["b", "c", "k", "j"], ["c", "d", "l", "k"], ["d", "e", "f", "l"]]
    return {
        "vertices": {name: list(place) for name, place in places.items()} | {"e": [0, third], "f": [1, third]},
        "blocks": [{"name": f"part{k}", "corners": names, "cells": [2, 2]} for k, names in enumerate(corners)],
    }


def test_blocks_that_overlap_are_named_with_their_edges_and_the_place() -> None:
    assert Blocks.of(around(1.5)).mesh.cell_areas().sum() == pytest.approx(7.0)
    with pytest.raises(em.InputError, match=r"part3 and part0 overlap near|part0 and part3 overlap near") as caught:
        Blocks.of(around(0.5))
    words = str(caught.value)
    x, y = map(float, re.findall(r"near \(([-\d.e]+), ([-\d.e]+)\)", words)[0])
    assert 0 <= x <= 1
    assert 0 <= y <= 1
    assert re.search(r"at the boundary (i-a|a-i|i-j|j-i|a-b) and (\w-\w); move their vertices", words)
    assert caught.value.field == "domain.blocks[3]"


def test_a_block_inside_of_another_one_is_named() -> None:
    document = {
        "vertices": {
            "a": [0, 0],
            "b": [10, 4],
            "c": [10, 5],
            "d": [0, 9],
            "p": [3, 4],
            "q": [4, 4],
            "r": [4, 5],
            "s": [3, 5],
        },
        "blocks": [
            {"name": "large", "corners": ["a", "b", "c", "d"], "cells": [8, 8]},
            {"name": "small", "corners": ["p", "q", "r", "s"], "cells": [1, 8]},
        ],
        "joins": [{"from": ["p", "s"], "to": ["b", "c"]}],
    }
    with pytest.raises(em.InputError, match=r"small and large overlap near \(.*\): ") as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.blocks[1]"


def test_blocks_that_are_not_connected_are_named() -> None:
    document = {
        "vertices": {f"v{i}{j}": [i, j] for i in range(4) for j in range(3)},
        "blocks": [
            {"corners": ["v00", "v10", "v11", "v01"], "cells": [2, 2]},
            {"corners": ["v11", "v21", "v22", "v12"], "cells": [2, 2]},
        ],
    }
    used = {name for block in document["blocks"] for name in block["corners"]}
    document["vertices"] = {name: at for name, at in document["vertices"].items() if name in used}
    match = "block1 is not connected with block0: no edge leads to it, so give v11-v12 or v21-v22 or v11-v21 or v12-v22"
    with pytest.raises(em.InputError, match=match) as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.blocks[1]"
    joined = document | {"joins": [{"from": ["v00", "v01"], "to": ["v21", "v22"]}]}
    assert len(Blocks.of(joined).mesh.blocks) == 2


# Places that a mesh covers twice.


# A step to the next square, in the directions right, up, left and down.
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


def chain(squares: Sequence[tuple[int, int]], cells: int = 1) -> Mesh:
    """Unit squares of ``cells`` x ``cells``, each of which has an edge in common with the one before, and no more."""
    numbers: dict[tuple[int, int], int] = {}
    points: list[tuple[float, float]] = []
    found, edges = [], []
    for i, j in squares:
        before, numbers = numbers, {}
        for at in ((cells * i + k, cells * j + m) for k in range(cells + 1) for m in range(cells + 1)):
            numbers[at] = before.get(at, len(points))
            if at not in before:
                points.append((at[0] / cells, at[1] / cells))
        for k, m in ((cells * i + k, cells * j + m) for k in range(cells) for m in range(cells)):
            quad = [numbers[at] for at in ((k, m), (k + 1, m), (k + 1, m + 1), (k, m + 1))]
            found.append(quad)
            edges += list(zip(quad, quad[1:] + quad[:1], strict=True))
    boundary = [edge for edge in edges if edge[::-1] not in set(edges)]
    return Mesh(points=np.array(points), cells=np.array(found), sides={"all": np.array(boundary)})


@pytest.mark.parametrize("cells", [1, 3])
def test_chains_of_squares_overlap_where_they_come_to_one_square_again(cells: int) -> None:
    random = np.random.default_rng(20)
    seen = set()
    for _ in range(60):
        squares, way = [(0, 0)], 0
        for _ in range(int(random.integers(1, 12))):
            way = (way + int(random.choice([0, 1, 3]))) % 4
            squares.append((squares[-1][0] + STEPS[way][0], squares[-1][1] + STEPS[way][1]))
        mesh = chain(squares, cells)
        found = find_overlap(mesh)
        doubled = len(set(squares)) < len(squares)
        seen.add(doubled)
        assert (found is not None) == doubled, squares
        if found is not None:
            x, y = found.place
            assert squares.count((int(np.floor(x)), int(np.floor(y)))) > 1
            for corners in mesh.points[mesh.cells[list(found.cells)]]:
                assert (corners.min(axis=0) <= (x, y)).all()
                assert (corners.max(axis=0) >= (x, y)).all()
    assert seen == {True, False}


def square(x: float, y: float, size: float) -> NDArray[np.float64]:
    return np.array([[x, y], [x + size, y], [x + size, y + size], [x, y + size]])


@pytest.mark.parametrize(("shift", "overlaps"), [(1 - 1e-9, False), (1 - 1e-6, True), (1 / 3, True), (1, False)])
def test_squares_that_touch_to_rounding_do_not_overlap(shift: float, overlaps: bool) -> None:
    quads = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    mesh = Mesh(
        points=np.concatenate([square(0, 0, 1), square(shift, 0.5, 1)]),
        cells=quads,
        sides={"all": np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)},
    )
    assert (find_overlap(mesh) is not None) == overlaps


def test_a_part_inside_of_another_one_is_found_without_a_crossing() -> None:
    sheet = chain([(i, j) for i in range(7) for j in range(7)])  # squares beside each other that share no nodes
    points, number = np.unique(sheet.points, axis=0, return_inverse=True)
    cells = number.reshape(-1)[sheet.cells]
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2).tolist()
    outer = np.array([edge for edge in edges if edge[::-1] not in edges])
    small = len(points) + np.arange(4)
    hole = {"inner": np.column_stack([small, np.roll(small, -1)])}
    mesh = Mesh(
        points=np.concatenate([points, square(3.4, 3.3, 0.25)]),
        cells=np.concatenate([cells, small[None]]),
        sides={"outer": outer} | hole,
    )
    found = find_overlap(mesh)
    assert found.is_inside
    assert found.place == pytest.approx((3.525, 3.425))
    assert found.cells[0] == 49
    assert mesh.points[mesh.cells[found.cells[1]]].mean(axis=0) == pytest.approx((3.5, 3.5))


@pytest.mark.parametrize("name", ["obstacle", "disc", "naca0012_c", "pitz_daily"])
def test_good_domains_do_not_overlap(name: str) -> None:
    assert find_overlap(getattr(geometries, name)(300).mesh) is None


def test_a_mesh_that_overlaps_itself_is_refused() -> None:
    around = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 0)]
    mesh = chain(around)
    off = mesh.points.copy()
    off[mesh.cells[-1]] += (0.05, -0.1)  # no two nodes lie at one place
    with pytest.raises(
        em.InputError, match=r"the cells \d and \d overlap near \(.*\): repair the mesh there"
    ) as caught:
        Blocks.of_mesh(off, mesh.cells, {})
    assert caught.value.field == "cells"


def test_few_pairs_of_long_thin_slanted_cells_are_compared() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 301), np.linspace(0, 1, 3), indexing="ij")
    numbers = np.arange(x.size).reshape(x.shape)
    cells = np.stack([numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]], axis=-1).reshape(-1, 4)
    line = np.concatenate([numbers[:, 0], numbers[-1, 1:], numbers[-2::-1, -1], numbers[0, -2:0:-1]])
    edges = np.column_stack([line, np.roll(line, -1)])
    points = np.stack([x - y, x + y], axis=-1).reshape(-1, 2)
    mesh = Mesh(points=points, cells=cells, sides={"all": edges})
    one, _ = _pairs_of_cells(mesh, edges, np.arange(len(cells)), 1e-8)
    assert len(cells) - 2 < len(one) < 5 * len(cells)
    assert find_overlap(mesh) is None
