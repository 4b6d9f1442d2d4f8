"""Rows: cut into strips, shared out among threads, and the rows of a mesh that are held."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest

from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.rows import MIN_SHARED_NODES, MIN_STRIP_ROWS, STRIP_NODES, Rows, Share, subtree


@pytest.mark.parametrize("threads", [1, 2, 3, 7, 64])
@pytest.mark.parametrize("shape", [(1025, 1025), (257, 300), (129, 190), (70, 4000), (16384, 5)])
def test_every_row_belongs_to_one_share_and_every_strip_too(shape: tuple[int, int], threads: int) -> None:
    rows = Rows.whole(shape, threads)
    assert len(rows.shares) == min(threads, len(rows.node_strips))
    assert [row for share in rows.shares for row in range(*share.ends)] == list(range(shape[0]))
    assert [k for share in rows.shares for k in share.strips] == list(range(len(rows.node_strips)))
    assert [row for first, last in rows.node_strips for row in range(first, last)] == list(range(1, shape[0] - 1))
    for share in rows.shares:
        within = [row for k in share.strips for row in range(*rows.node_strips[k])]
        assert set(within) <= set(range(*share.ends)), "a strip lies in its share"


def test_strips_depend_on_the_grid_alone() -> None:
    assert len({Rows.whole((700, 513), threads).node_strips for threads in (1, 2, 3)}) == 1
    heights = [last - first for first, last in Rows.whole((1025, 1025)).node_strips]
    assert max(heights) * 1025 >= STRIP_NODES > (max(heights) - 1) * 1025
    assert max(last - first for first, last in Rows.whole((100, 100_000)).node_strips) == MIN_STRIP_ROWS


def test_small_grids_are_not_shared() -> None:
    assert len(Rows.whole((127, 127), 8).shares) == 1
    assert MIN_SHARED_NODES > 127 * 127
    assert [share.ends for share in Rows.whole((2, 2)).shares] == [(0, 2)], "two rows have no row between them"


def test_shares_are_equal_in_size_and_answer_in_the_order_of_the_rows() -> None:
    rows = Rows.whole((1025, 1025), 2)
    sizes = rows.each(lambda share: share.last - share.first)
    assert abs(sizes[0] - sizes[1]) <= 33
    assert rows.each(lambda share: share.first) == [0, sizes[0]]
    assert rows.largest_here(lambda share: float(share.last)) == 1025.0
    assert rows.shares[0].rows_and_next == slice(0, sizes[0] + 1)


def test_some_rows_count_their_own_ones_from_the_first_that_is_here() -> None:
    rows = Rows(shape=(700, 513), begin=64, end=130, first=65, last=129)
    assert (rows.here, rows.here_shape, rows.own_nodes) == (slice(64, 130), (66, 513), slice(1, 65))
    assert rows.node_strips == ((1, 65),)
    assert rows.strips == ((65, 129),)
    assert Rows.whole((700, 513)).own_nodes == slice(0, 700)
    assert Rows(shape=(9, 5), begin=7, end=9, first=8, last=8).own_nodes == slice(1, 1), (
        "who has cells has the last row"
    )


def test_all_rows_are_joined_and_summed_as_they_are() -> None:
    rows, found = Rows.whole((9, 5)), np.arange(6.0).reshape(3, 2)
    assert rows.are_all
    assert rows.joined(found) is found
    assert rows.summed(found) is found
    assert rows.agreed(3.0, math.inf) == (3.0, math.inf)


@pytest.mark.parametrize("threads", [2, 5])
def test_threads_work_at_the_same_time(threads: int) -> None:
    """The last share is the first to end: each waits for the one after it."""
    rows = Rows.whole((1025, 1025), threads)
    done = {share: threading.Event() for share in rows.shares}

    def work(share: Share) -> int:
        after = rows.shares.index(share) + 1
        assert after == threads or done[rows.shares[after]].wait(timeout=60)
        done[share].set()
        return threading.get_ident()

    assert len(set(rows.each(work))) == threads, "every share has its own thread"


@pytest.mark.parametrize("bad", range(3))
def test_what_is_not_a_number_is_not_overlooked(bad: int) -> None:
    rows = Rows.whole((1025, 1025), 3)
    assert math.isnan(rows.largest_here(lambda share: math.nan if share == rows.shares[bad] else float(share.first)))


@pytest.mark.parametrize("bad", range(2))
def test_the_error_of_a_thread_reaches_the_caller(bad: int) -> None:
    rows = Rows.whole((1025, 1025), 2)

    def work(share: Share) -> int:
        if share == rows.shares[bad]:
            raise ValueError(f"share {bad}")
        return share.first

    with pytest.raises(ValueError, match=f"share {bad}"):
        rows.each(work)


@pytest.mark.parametrize("strips", [1, 2, 7, 8, 33, 1024])
def test_a_tree_has_every_strip_once(strips: int) -> None:
    tree = subtree(0, strips)
    assert len(tree) == strips - 1
    assert sorted(middle for _, middle, _ in tree.tolist()) == list(range(1, strips))
    assert (tree[:, 1] == (tree[:, 0] + tree[:, 2]) // 2).all()


MESH = Mesh.uniform(Grid(n_xi=1400, n_eta=90))


def test_the_uniform_mesh_is_known_by_rows() -> None:
    rows = Rows(shape=MESH.x.shape, begin=3, end=10, first=4, last=8)
    some = MeshRows.uniform(rows)
    assert np.array_equal(some.x, MESH.x[3:10])
    assert np.array_equal(some.nodes(4, 8)[1], MESH.y[4:9])


def test_rows_within_rows_are_counted_in_the_grid() -> None:
    every = MeshRows.of(MESH)
    some = every.within(3, 9).within(4, 8)
    assert (some.rows.begin, some.rows.end, some.grid) == (4, 8, MESH.grid)
    assert (some.rows.first, some.rows.last) == (4, 7), "the cells between the rows of nodes that are here"
    assert np.array_equal(some.x, MESH.x[4:8])
    assert np.shares_memory(some.x, every.x)
    assert (every.within(0, 8).rows.first, every.within(0, 8).rows.last) == (0, 7)


def test_names_of_parts_say_where_they_are() -> None:
    with pytest.raises(ImportError, match=r"equimesh\.meshes\.cut is equimesh_cluster\.cut now"):
        from equimesh.meshes import cut  # noqa: F401
