"""Decomposition: every node has one owner, neighbours share the overlap, and what does not fit is refused."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh as em


def test_the_two_strips_of_the_paper() -> None:
    decomposition = em.Decomposition(grid=em.Grid(n_xi=12, n_eta=12), subdomains=(2, 1), overlap=2)
    assert [part.columns for part in decomposition.parts] == [range(7), range(5, 12)]
    assert [part.owned[0] for part in decomposition.parts] == [slice(0, 5), slice(5, 12)]


@settings(max_examples=200, derandomize=True)
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
