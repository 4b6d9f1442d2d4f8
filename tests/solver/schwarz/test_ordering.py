"""The turns of an iteration: each subdomain once, in the order that the setting names."""

from __future__ import annotations

import itertools

import pytest

import equimesh as em
from equimesh.schwarz.decomposition import turns

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


def test_a_single_subdomain_is_solved_once() -> None:
    assert {str(turns(decomposition(1, 1), ordering)) for ordering in em.Ordering} == {"[[0]]"}


@pytest.mark.parametrize(("along_xi", "along_eta"), [(2, 2), (3, 2), (5, 4), (2, 1)])
def test_no_two_blocks_of_one_colour_touch(along_xi: int, along_eta: int) -> None:
    blocks = decomposition(along_xi, along_eta)
    found = turns(blocks, em.Ordering.COLOURED)
    assert sorted(itertools.chain(*found)) == list(range(along_xi * along_eta))
    assert len(found) == 2 * min(along_eta, 2)
    for turn in found:
        for one, other in itertools.combinations([blocks.parts[k].place for k in turn], 2):
            assert max(abs(one[0] - other[0]), abs(one[1] - other[1])) > 1
