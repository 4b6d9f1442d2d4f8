"""A structured mesh with closed lines as a mesh of quadrilaterals, whose copies of a node are one if they can be."""

from __future__ import annotations

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array, BoolArray, IntArray

SEAMS = (("left", "right"), ("bottom", "top"))
"""The sides that are the two copies of a seam, of closed xi-lines and of closed eta-lines."""


def joined(mesh: Mesh, ties: IntArray) -> QuadMesh:
    """The mesh without the second copies of nodes that lie where the first ones do, as around a ring.

    ``ties``, shape ``(k, 2)``, are the copies and their originals. Such a seam is no side any more. Copies that lie a
    period apart stay, with their sides, as the ``ties`` of the mesh.
    """
    points = mesh.points
    same = at_one_place(points, ties)
    stands = np.arange(len(points))
    stands[ties[same, 0]] = ties[same, 1]
    kept = np.flatnonzero(stands == np.arange(len(points)))
    number = np.zeros(len(points), dtype=np.int64)
    number[kept] = np.arange(kept.size)
    number = number[stands]
    sides = dict(mesh.sides)
    for seam in SEAMS:
        edges = np.sort(number[np.concatenate([sides[name] for name in seam])], axis=1)
        if len(np.unique(edges, axis=0)) < len(edges):
            for name in seam:
                del sides[name]
    return QuadMesh(
        points=points[kept],
        cells=number[mesh.cells],
        sides={name: number[edges] for name, edges in sides.items()},
        blocks=(number.reshape(mesh.grid.shape),),
        ties=number[ties[~same]],
    )


def at_one_place(points: Array, ties: IntArray) -> BoolArray:
    """Which of the ``ties`` bind two nodes at the same place, shape ``(k,)``."""
    found: BoolArray = (points[ties[:, 0]] == points[ties[:, 1]]).all(axis=1)
    return found
