"""The turns of a Schwarz iteration: which subdomains are solved at the same time, and in which order."""

from __future__ import annotations

from enum import StrEnum

from equimesh.schwarz.decomposition import Decomposition


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


class Ordering(StrEnum):
    """Which subdomains are solved at the same time; it determines the data that they read.

    ``PARALLEL``: all, with data of the previous iteration (the default). ``ALTERNATING``: one after the other, with the
    newest data, as in the paper. ``SYMMETRIC``: the same, first forward and then backward. ``COLOURED``: every other
    strip, or every other block in both directions, at the same time: two or four turns an iteration.
    """

    PARALLEL = "parallel"
    ALTERNATING = "alternating"
    SYMMETRIC = "symmetric"
    COLOURED = "coloured"
