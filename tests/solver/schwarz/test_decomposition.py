"""Decomposition: every node has one owner, neighbours share the overlap, and what does not fit is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh as em
from cases import problem
from equimesh.schwarz.decomposition import SubdomainWindow, turns
from equimesh.schwarz.line_corrections import WholeLineSums
from equimesh.schwarz.optimized import yielding_sides
from solver.schwarz.bent import bent


@settings(max_examples=100, derandomize=True)
@given(
    points=st.tuples(st.integers(4, 60), st.integers(4, 60)),
    subdomains=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    overlap=st.integers(2, 9),
)
def test_owners_cover_the_grid_once(points: tuple[int, int], subdomains: tuple[int, int], overlap: int) -> None:
    grid = em.Grid(n_xi=points[0], n_eta=points[1])
    try:
        decomposition = em.Decomposition(grid=grid, subdomains=subdomains, overlap=overlap)
    except em.DecompositionError:
        for n, count in zip(points, subdomains, strict=True):
            if count > 1 and (n + (count - 1) * overlap) // count <= overlap:
                return
        raise
    owners = np.zeros(grid.shape, dtype=int)
    for part in decomposition.parts:
        owners[part.owned] += 1
        owned = [range(*cut.indices(n)) for cut, n in zip(part.owned, grid.shape, strict=True)]
        assert set(owned[0]) <= set(part.columns)
        assert set(owned[1]) <= set(part.rows)
    assert (owners == 1).all()
    for spans in decomposition.spans:
        assert all(left.last - right.first + 1 == overlap for left, right in itertools.pairwise(spans))
        assert max(span.size for span in spans) - min(span.size for span in spans) <= 1


@pytest.mark.parametrize(
    ("n", "subdomains", "overlap", "field", "words"),
    [
        (12, (2, 1), 1, "overlap", ["at least 2"]),
        (12, (0, 1), 2, "subdomains", ["at least 1"]),
        (12, (13, 1), 2, "subdomains", ["13 subdomains in xi", "12 columns", "at most 10 subdomains"]),
        (12, (1, 4), 9, "overlap", ["4 subdomains in eta", "at most 3 subdomains", "an overlap of at most 8"]),
        (12, (2, 1), 12, "overlap", ["at most 1 subdomains", "an overlap of at most 10"]),
    ],
)
def test_what_does_not_fit_is_refused_with_what_would(
    n: int, subdomains: tuple[int, int], overlap: int, field: str, words: list[str]
) -> None:
    with pytest.raises(em.DecompositionError) as caught:
        em.Decomposition(grid=em.Grid(n_xi=n, n_eta=n), subdomains=subdomains, overlap=overlap)
    assert caught.value.field == field
    assert all(word in caught.value.message for word in words), caught.value.message


@pytest.mark.parametrize(("subdomains", "overlap"), [((10, 1), 2), ((1, 3), 9), ((1, 4), 8), ((2, 1), 10)])
def test_what_the_messages_offer_does_fit(subdomains: tuple[int, int], overlap: int) -> None:
    em.Decomposition(grid=em.Grid(n_xi=12, n_eta=12), subdomains=subdomains, overlap=overlap)


@pytest.mark.parametrize("overlap", range(2, 8))
def test_the_overlap_is_laid_around_the_cuts(overlap: int) -> None:
    decomposition = em.Decomposition(
        grid=em.Grid(n_xi=41, n_eta=21), subdomains=(3, 2), overlap=overlap, cuts=((8, 25), (12,))
    )
    xi, eta = decomposition.spans
    assert [span.owned_first for span in xi] == [0, 8, 25]
    assert [span.owned_last for span in xi] == [7, 24, 40]
    assert [span.owned_first for span in eta] == [0, 12]
    for spans in (xi, eta):
        for left, right in itertools.pairwise(spans):
            assert left.last - right.first + 1 == overlap
            assert abs((left.last - right.owned_first) - (right.owned_first - right.first)) <= 1
        assert (spans[0].first, spans[-1].last) == (0, 40 if spans is xi else 20)


@pytest.mark.parametrize(
    ("cuts", "words"),
    [
        ((5, 5), ["[5, 5] in xi", "ascending"]),
        ((5,), ["one line fewer"]),
        ((1, 5), ["line 1 in xi", "lines 2 to 8"]),
        ((5, 10), ["line 10 in xi", "lines 2 to 8"]),
    ],
)
def test_cuts_that_do_not_fit_are_refused_with_those_that_do(cuts: tuple[int, ...], words: list[str]) -> None:
    with pytest.raises(em.DecompositionError) as caught:
        em.Decomposition(grid=em.Grid(n_xi=12, n_eta=12), subdomains=(3, 1), overlap=4, cuts=(cuts, None))
    assert caught.value.field == "subdomains"
    assert all(word in caught.value.message for word in words), caught.value.message
    em.Decomposition(grid=em.Grid(n_xi=12, n_eta=12), subdomains=(3, 1), overlap=4, cuts=((2, 8), None))


# The rest of every line beyond an interface: its length, and how that follows the interface.


CASE = problem("paper", 20, 17)
STRIPS = em.Decomposition(grid=CASE.grid, subdomains=(3, 1), overlap=4)
MIDDLE = STRIPS.parts[1]


def rests(mesh: em.Mesh, *, local: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """What lies beyond the two interfaces of the middle strip, its nodes where they are in the merged mesh."""
    window = SubdomainWindow(STRIPS, MIDDLE, 1)
    sums = WholeLineSums(CASE, ({MIDDLE.columns[0], MIDDLE.columns[-1]}, set()))
    sums.read(mesh)
    state = window.restrict(mesh)
    lower, upper = yielding_sides(CASE.metric, window, state, sums, local=local).rest(state.x, state.y)[0]
    return lower, upper


def test_where_nothing_moved_the_rest_is_what_was_summed() -> None:
    mesh = bent(CASE, 0.01)
    sums = WholeLineSums(CASE, ({MIDDLE.columns[0], MIDDLE.columns[-1]}, set()))
    sums.read(mesh)
    lower, upper = rests(mesh)
    assert lower[1:-1] == pytest.approx(sums.beyond_point(0, 0, MIDDLE.columns[0])[1:-1])
    assert upper[1:-1] == pytest.approx(sums.beyond_point(0, 1, MIDDLE.columns[-1])[1:-1])


def test_on_an_equidistributed_mesh_one_edge_speaks_for_all() -> None:
    solution = em.solve(CASE, mode=em.Mode.TIGHT).reference
    for whole, local in zip(rests(solution), rests(solution, local=True), strict=True):
        assert local[1:-1] == pytest.approx(whole[1:-1], rel=1e-7)


@pytest.mark.parametrize("end", [0, 1])
def test_the_rest_follows_the_interface_as_the_sums_do(end: int) -> None:
    """Where the rest stays equidistributed while the interface moves; here with a constant metric, exactly so."""
    flat = problem("paper", 20, 17, a=0.0)
    window, uniform = SubdomainWindow(STRIPS, MIDDLE, 1), em.Mesh.uniform(flat.grid)
    point = MIDDLE.columns[-1 if end else 0]
    sums = WholeLineSums(flat, ({MIDDLE.columns[0], MIDDLE.columns[-1]}, set()))
    sums.read(uniform)
    state = window.restrict(uniform)
    found = yielding_sides(flat.metric, window, state, sums, local=False)
    step = 1e-4
    moved = state.x.copy()
    moved[-2 if end else 1] += step
    # N edges of length L / N: the sum of their squares is L^2 / N.
    edges, length = (19 - point, 1 - point / 19) if end else (point, point / 19)
    new = (length - step if end else length + step) ** 2 / edges
    assert found.rest(moved, state.y)[0][end] == pytest.approx(np.full(17, new), abs=2 * step**2)
    assert found.rest(state.x, state.y)[0][end] == pytest.approx(np.full(17, length**2 / edges))


# The turns of an iteration: each subdomain once, in the order that the setting names.


GRID = em.Grid(n_xi=40, n_eta=40)


def decomposition(along_xi: int, along_eta: int) -> em.Decomposition:
    return em.Decomposition(grid=GRID, subdomains=(along_xi, along_eta), overlap=2)


@pytest.mark.parametrize(
    ("ordering", "expected"),
    [
        (em.Ordering.PARALLEL, [[0, 1, 2]]),
        (em.Ordering.ALTERNATING, [[0], [1], [2]]),
        (em.Ordering.SYMMETRIC, [[0], [1], [2], [1], [0]]),
        (em.Ordering.COLOURED, [[0, 2], [1]]),
    ],
    ids=str,
)
def test_three_strips(ordering: em.Ordering, expected: list[list[int]]) -> None:
    assert turns(decomposition(3, 1), ordering) == expected
    assert turns(decomposition(1, 3), ordering) == expected


@pytest.mark.parametrize(("along_xi", "along_eta"), [(2, 2), (3, 2), (5, 4), (2, 1)])
def test_no_two_blocks_of_one_colour_touch(along_xi: int, along_eta: int) -> None:
    blocks = decomposition(along_xi, along_eta)
    found = turns(blocks, em.Ordering.COLOURED)
    assert sorted(itertools.chain(*found)) == list(range(along_xi * along_eta))
    assert len(found) == 2 * min(along_eta, 2)
    for turn in found:
        for one, other in itertools.combinations([blocks.parts[k].place for k in turn], 2):
            assert max(abs(one[0] - other[0]), abs(one[1] - other[1])) > 1
