"""Sides of a mesh that are joined by a translation: what solvers call a pair of periodic boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.cell_edges import originals_of
from equimesh.numerics.types import Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Join:
    """Two named sides that are one: the ``original`` and its ``copy``, which lies ``translation`` away from it.

    ``edges`` are those of the copy, shape ``(k, 2)``, each in the place of its original among the edges of that side,
    and in its direction: ``edges[k, 0]`` is the copy of the node ``sides[original][k, 0]``. So they have the domain on
    their right. ``original_edges`` are those of the original.
    """

    original: str
    copy: str
    edges: IntArray
    original_edges: IntArray
    translation: Array

    @property
    def nodes(self) -> IntArray:
        """The pairs of nodes (copy, original) along the two sides, shape ``(n, 2)``, each once."""
        pairs: IntArray = np.unique(np.column_stack([self.edges.ravel(), self.original_edges.ravel()]), axis=0)
        return pairs


def joins_of(points: Array, sides: Mapping[str, IntArray], ties: IntArray) -> tuple[Join, ...]:
    """The pairs of joined sides; ``ties``, shape ``(k, 2)``, are nodes that are copies, and their originals.

    Raises :class:`~equimesh.errors.InputError` where a side is joined in part, to several sides, or to itself.
    """
    originals = originals_of(len(points), ties)
    if originals is None:
        return ()
    keys = {name: _keys(originals[edges]) for name, edges in sides.items()}
    copies = {name: int(np.isin(edges, ties[:, 0]).sum()) for name, edges in sides.items()}
    found, joined = [], set[str]()
    for one, two in combinations(sides, 2):
        if np.isin(keys[one], keys[two]).any():
            original, copy = (two, one) if copies[one] > copies[two] else (one, two)
            if joined & {one, two} or not np.array_equal(np.sort(keys[one]), np.sort(keys[two])):
                raise _in_part(one)
            joined |= {one, two}
            places = np.argsort(keys[copy])[np.searchsorted(np.sort(keys[copy]), keys[original])]
            edges = sides[copy][places, ::-1]
            translation = points[edges[0, 0]] - points[sides[original][0, 0]]
            found.append(
                Join(
                    original=original,
                    copy=copy,
                    edges=edges,
                    original_edges=sides[original],
                    translation=translation,
                )
            )
    for name, found_keys in keys.items():
        if len(np.unique(found_keys)) < len(found_keys):
            raise _in_part(name)
    return tuple(found)


def _keys(edges: IntArray) -> IntArray:
    """One number for each edge, the same in both directions."""
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys: IntArray = low << 32 | high
    return keys


def _in_part(name: str) -> InputError:
    message = f"the side {name} is joined in part, to several sides, or to itself: name each joined edge as a side"
    return InputError(message, field="sides")
