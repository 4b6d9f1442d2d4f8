"""Places that a mesh covers twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.blocks.checks import _pairs_of_cells, find_overlap
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.testing import geometries

# A step to the next square, in the directions right, up, left and down.
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


def chain(squares: Sequence[tuple[int, int]], cells: int = 1) -> QuadMesh:
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
    return QuadMesh(points=np.array(points), cells=np.array(found), sides={"all": np.array(boundary)})


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
    mesh = QuadMesh(
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
    mesh = QuadMesh(
        points=np.concatenate([points, square(3.4, 3.3, 0.25)]),
        cells=np.concatenate([cells, small[None]]),
        sides={"outer": outer} | hole,
    )
    found = find_overlap(mesh)
    assert found is not None
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
    mesh = QuadMesh(points=points, cells=cells, sides={"all": edges})
    one, _ = _pairs_of_cells(mesh, edges, np.arange(len(cells)), 1e-8)
    assert len(cells) - 2 < len(one) < 5 * len(cells)
    assert find_overlap(mesh) is None
