"""The turns of a Schwarz iteration: which subdomains are solved at the same time, and in which order."""

from __future__ import annotations

from equimesh.schwarz.decomposition import Decomposition
from equimesh.schwarz.settings import Ordering


def turns(decomposition: Decomposition, ordering: Ordering) -> list[list[int]]:
    """The numbers of the subdomains of every turn; those of one turn read the same data."""
    numbers = [part.number for part in decomposition.parts]
    if ordering is Ordering.PARALLEL:
        return [numbers]
    if ordering is Ordering.COLOURED:
        return _colours(decomposition)
    forward = [[number] for number in numbers]
    return forward if ordering is Ordering.ALTERNATING else [*forward, *forward[-2::-1]]


def _colours(decomposition: Decomposition) -> list[list[int]]:
    """Every other subdomain along xi and along eta."""
    found: dict[tuple[int, int], list[int]] = {}
    for part in decomposition.parts:
        found.setdefault((part.place[0] % 2, part.place[1] % 2), []).append(part.number)
    return [found[colour] for colour in sorted(found)]
