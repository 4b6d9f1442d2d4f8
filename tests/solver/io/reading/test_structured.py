"""Plot3D files in all their kinds, blocks that are joined, and what broken ones are told."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from equimesh.errors import InputError
from equimesh.io.reading import structured
from equimesh.io.reading.read import read_bytes
from equimesh.io.reading.structured import joined, read_plot3d
from equimesh.numerics.types import Array
from solver.io.reading.plain import refusal, small


def two_blocks() -> list[Array]:
    """The small mesh in two blocks of 2 x 3 and 3 x 3 nodes, the second with its directions exchanged."""
    points = small().points.reshape(4, 3, 2)
    return [points[:2], points[1:].swapaxes(0, 1)]


def numbers(blocks: list[Array], *, dimension: int, blanked: bool) -> tuple[list[int], list[Array]]:
    """The head and the values of each block."""
    head = [len(blocks)]
    values = []
    for block in blocks:
        head += [*block.shape[:2], 1][:dimension]
        flat = [block[..., k].ravel(order="F") for k in range(2)]
        if dimension == 3:
            flat.append(np.full(flat[0].size, 0.5))
        if blanked:
            flat.append(np.ones(flat[0].size))
        values.append(np.concatenate(flat))
    return head, values


def text(blocks: list[Array], *, dimension: int = 2, blanked: bool = False) -> bytes:
    head, values = numbers(blocks, dimension=dimension, blanked=blanked)
    rows = [" ".join(map(str, head)), *(" ".join(map(repr, value.tolist())) for value in values)]
    return "\n".join(rows).encode()


def binary(blocks: list[Array], order: str, kind: str, *, records: bool, blanked: bool) -> bytes:
    head, values = numbers(blocks, dimension=2, blanked=False)
    pieces = [np.array(head[:1], f"{order}i4").tobytes(), np.array(head[1:], f"{order}i4").tobytes()]
    for value in values:
        ones = np.ones(len(value) // 2, f"{order}i4").tobytes() if blanked else b""
        pieces.append(value.astype(f"{order}{kind}").tobytes() + ones)
    if records:
        pieces = [m + p + m for p in pieces for m in (np.array([len(p)], f"{order}i4").tobytes(),)]
    return b"".join(pieces)


@pytest.mark.parametrize(("dimension", "blanked"), list(itertools.product((2, 3), (False, True))))
def test_texts_of_any_kind(dimension: int, blanked: bool) -> None:
    check(read_bytes(text(two_blocks(), dimension=dimension, blanked=blanked), "p3d"))


@pytest.mark.parametrize(
    ("order", "kind", "records", "blanked"), list(itertools.product("<>", ("f8", "f4"), (False, True), (False, True)))
)
def test_binary_files_of_any_kind(order: str, kind: str, records: bool, blanked: bool) -> None:
    data = binary(two_blocks(), order, kind, records=records, blanked=blanked)
    check(read_bytes(data, "p3d"), 1e-7 if kind == "f4" else 0.0)


def check(found: object, apart: float = 0.0) -> None:
    """The two blocks have their three common nodes once; points are in the order of the file."""
    one, other = two_blocks()
    wanted = np.concatenate([one.reshape(-1, 2), other[:, 1:].reshape(-1, 2)])
    np.testing.assert_allclose(found.points, wanted, rtol=0, atol=apart)  # type: ignore[attr-defined]
    assert found.cells.shape == (6, 4)  # type: ignore[attr-defined]
    assert len(np.unique(found.cells)) == 12  # type: ignore[attr-defined]


def test_one_block_without_its_number_and_with_repeated_numbers() -> None:
    mesh = read_bytes(b"2 3\n0, 1.D0, 0 1 0 1  2*0.0 2*0.5 2*1.0", "p3d")
    assert mesh.points.tolist() == [[0, 0], [0, 0.5], [0, 1], [1, 0], [1, 0.5], [1, 1]]
    assert mesh.cells.tolist() == [[0, 3, 4, 1], [1, 4, 5, 2]]


def test_a_block_that_closes_on_itself_has_its_seam_once() -> None:
    angle = np.linspace(0, 2 * np.pi, 13)
    block = np.stack([r * np.stack([np.cos(angle), np.sin(angle)], -1) for r in (1, 1.5, 2)], 1)
    mesh = read_bytes(text([block]), "p3d")
    assert len(mesh.points) == 36
    assert len(mesh.cells) == 24
    assert mesh.cells[-2:, 1].tolist() == [0, 1]


def test_sides_are_edges_of_blocks() -> None:
    mesh = joined(two_blocks(), {"left": [(0, np.array([[2, 1], [1, 0]]))], "cut": [(1, np.array([[0, 3], [3, 6]]))]})
    assert mesh.sides["left"].tolist() == [[2, 1], [1, 0]]
    assert mesh.sides["cut"].tolist() == [[3, 4], [4, 5]]


MAP = """# a comment
2
1 2 3 1
2 3 3 1
'ONE_TO_ONE' 1 4 1 3 1 1 2 5 1 1 1 3 TRUE
'left' 1 3 1 3 1 1
two words 2 4 1 1 1 3
'lower' 1 5 1 1 1 2
'lower' 2 3 1 3 1 1
"""


def test_a_map_names_the_sides() -> None:
    mesh = read_plot3d(text(two_blocks()), MAP.encode())
    assert {name: len(edges) for name, edges in mesh.sides.items()} == {"left": 2, "two words": 2, "lower": 3}
    np.testing.assert_array_equal(np.unique(mesh.sides["left"]), [0, 1, 2])
    assert (mesh.points[mesh.sides["lower"], 1] < 0.02).all()
    for row, told in (
        ("'left' 1 3 1 4 1 1", "line 1 of the map: nodes 1 to 4, but the face has 3"),
        ("w 3 3 1 2 1 1", "no face 3 of a block 3"),
    ):
        with pytest.raises(InputError, match=told):
            read_plot3d(text(two_blocks()), row.encode())


BROKEN = {
    "no Plot3D grid of plane blocks": text(two_blocks())[:-30],
    "line 2: '0.1x' is no number": b"2 2\n0 0.1x 0 1 0 0 1 1",
    "block 0 of the file has the coordinates [nan, 0.0]": b"2 2\nnan 1 0 1 0 0 1 1",
}


@pytest.mark.parametrize("told", BROKEN)
def test_broken_files_are_refused(told: str) -> None:
    assert told in refusal(BROKEN[told], "p3d")
    assert "no Plot3D grid" in refusal(binary(two_blocks(), "<", "f8", records=False, blanked=False)[:-8], "p3d")


def test_small_files_stand_for_no_huge_ones() -> None:
    with pytest.raises(InputError, match="repetitions stand for more than 100040 numbers"):
        read_plot3d(b"2 2 " + b"9999999*0.5 " * 3)
    with pytest.raises(InputError, match="of the map: the sides have more edges than the blocks"):
        read_plot3d(text(two_blocks()[:1]), b"\n".join([b"wall 1 3 1 3 1 1"] * 20))


def test_long_rows_of_a_map_take_time_by_their_length() -> None:
    rows = b"a " * 50_000 + b"\n" + b"wall" + b" " * 50_000 + b"1\nwall 1 3 1 3 1 1"
    assert list(read_plot3d(text(two_blocks()[:1]), rows).sides) == ["wall"]


def test_many_nodes_at_one_place_are_joined_soon() -> None:
    n = 20_000
    x = np.concatenate([1e-14 * np.random.default_rng(1).random(2 * n - 1), [1.0]])
    began = time.process_time()
    message = refusal(f"{n} 2 " + " ".join(map(repr, x.tolist())) + " 0" * (2 * n), "p3d")
    assert time.process_time() - began < 8.0
    assert f"{n - 1} cells of 2 nodes" in message


def test_places_are_joined_over_a_short_distance_alone() -> None:
    near, far = 0.99, 5.0
    steps = np.tile([near] * 6 + [far], 30)
    line = np.cumsum(steps)
    places = np.column_stack([np.cos(0.7) * line, np.sin(0.7) * line])
    one, other = structured._at_same_place(places, 1.0)
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(line), len(line)))
    number, group = connected_components(graph, directed=False)
    np.testing.assert_array_equal(np.diff(group) == 0, steps[1:] == near)
    assert number == 31
