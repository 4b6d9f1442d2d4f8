"""A mesh with its copies beyond periodic joins, so that points near a join are found on both of its sides."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import QuadSearch
from equimesh.numerics.types import Array, IntArray

ROUNDING = 1e-9
"""The share of the extent of a mesh by which the translations of two ties may differ and be the same."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Unrolled:
    """The search in a mesh and in its copies by the translations of its periodic joins.

    Without joins there are no copies. The cells of the mesh itself come first, with their own numbers; cell k of copy
    c has the number ``c * m + k``.
    """

    search: QuadSearch
    nodes: IntArray
    """The node of the mesh that each node of the copies is."""
    cells: int
    """The number of cells of the mesh itself."""

    @classmethod
    def of(cls, mesh: Mesh) -> Unrolled:
        """The search in a valid mesh."""
        if not len(mesh.ties):
            search = QuadSearch.of(mesh.points, mesh.cells)
            return cls(search=search, nodes=np.arange(len(mesh.points)), cells=len(mesh.cells))
        translations, count = translations_of(mesh), len(mesh.points)
        moves = _moves(translations)
        number = _joined(mesh, translations, moves)
        points = np.concatenate([mesh.points + np.asarray(move) @ translations for move in moves])
        kept, cells = np.unique(number[:, mesh.cells].reshape(-1, 4), return_inverse=True)
        search = QuadSearch.of(points[kept], cells.reshape(-1, 4))
        return cls(search=search, nodes=kept % count, cells=len(mesh.cells))


def translations_of(mesh: Mesh) -> Array:
    """The different translations from the originals to the copies of a mesh, shape ``(1 or 2, 2)``.

    A corner of a mesh that is joined both ways may have the sum of both, which is left out.
    """
    apart = mesh.points[mesh.ties[:, 0]] - mesh.points[mesh.ties[:, 1]]
    rounding = ROUNDING * float(np.ptp(mesh.points, axis=0).max())
    found: list[Array] = []
    for one in apart[np.argsort(np.abs(apart).sum(axis=1), kind="stable")]:
        steps = np.rint(one @ np.linalg.pinv(np.array(found))) if found else np.zeros(0)
        if np.abs(one - steps @ np.array(found).reshape(-1, 2)).max() > rounding:
            found.append(one)
            if len(found) == 2:  # two span the plane
                break
    return np.array(found)


def moves_of(mesh: Mesh) -> Array:
    """The translations of all copies of a mesh, the mesh itself first, shape ``(1, 3 or 9, 2)``."""
    if not len(mesh.ties):
        return np.zeros((1, 2))
    translations = translations_of(mesh)
    return np.array([np.asarray(move) @ translations for move in _moves(translations)])


def _moves(translations: Array) -> list[tuple[int, ...]]:
    """How often each translation is applied in each copy; first not at all."""
    return sorted(product((-1, 0, 1), repeat=len(translations)), key=any)


def _joined(mesh: Mesh, translations: Array, moves: list[tuple[int, ...]]) -> IntArray:
    """The number of each node of each copy, shape ``(copies, n)``; equal numbers are one node."""
    count, place = len(mesh.points), {move: k for k, move in enumerate(moves)}
    apart = mesh.points[mesh.ties[:, 0]] - mesh.points[mesh.ties[:, 1]]
    steps = np.rint(apart @ np.linalg.pinv(translations)).astype(int)
    pairs = []
    for step in np.unique(steps, axis=0):
        copies, originals = mesh.ties[(steps == step).all(axis=1)].T
        for move, k in place.items():
            beyond = place.get(tuple(int(one + other) for one, other in zip(move, step, strict=True)))
            if beyond is not None:
                pairs.append(np.stack([k * count + copies, beyond * count + originals]))
    one, other = np.concatenate(pairs, axis=1)
    whole = len(moves) * count
    graph = scipy.sparse.coo_array((np.ones(one.size), (one, other)), shape=(whole, whole))
    _, groups = scipy.sparse.csgraph.connected_components(graph, directed=False)
    first = np.full(whole, whole)
    np.minimum.at(first, groups, np.arange(whole))
    return first[groups].reshape(len(moves), count)
