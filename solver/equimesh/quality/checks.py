"""The checks of cells and faces that OpenFOAM's ``checkMesh -allGeometry`` makes, besides angles and skewness.

As in ``primitiveMeshTools`` of OpenFOAM 1912, for a mesh that is one cell thick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.quality.faces import measure_faces, points_and_centres

MIN_DETERMINANT = 0.001
"""The smallest determinant of a cell that passes."""
MIN_WEIGHT = 0.05
"""The smallest weight of a face that passes."""
MIN_VOLUME_RATIO = 0.01
"""The smallest ratio of the volumes of two neighbours that passes."""
MAX_SKEWNESS = 4.0
"""The largest skewness of a face that passes."""


@dataclass(frozen=True, kw_only=True)
class Checks:
    """The number that is checked; NaN for a folded mesh."""

    determinant: float
    """The smallest determinant of a cell: of the sum of its inner faces' area vectors times themselves, over 8.

    They are divided by their mean length. It is 0.5 for a square inside a mesh, and about 8 over the squared ratio of
    the sides for a long rectangle there.
    """
    weight: float
    """The smallest share of the distance of two centres, along the normal, that lies on one side of their face."""
    volume_ratio: float
    """The smallest ratio of the areas of two neighbours."""
    skewness: float
    """As :attr:`~equimesh.quality.faces.Faces.skewness`."""

    @property
    def passed(self) -> bool:
        """Whether all checks pass."""
        return (
            self.determinant >= MIN_DETERMINANT
            and self.weight >= MIN_WEIGHT
            and self.volume_ratio >= MIN_VOLUME_RATIO
            and self.skewness <= MAX_SKEWNESS
        )


def check_cells(mesh: Mesh) -> Checks:
    """The checks of ``mesh``."""
    points, centres = points_and_centres(mesh)
    if centres is None:
        return Checks(determinant=np.nan, weight=np.nan, volume_ratio=np.nan, skewness=np.nan)
    first, second = points[:, 1:, 1:] - points[:, :-1, :-1], points[:, :-1, 1:] - points[:, 1:, :-1]
    volume = first[0] * second[1] - first[1] * second[0]
    # The edges between neighbours along xi, and between those along eta, turned by a right angle.
    edges = np.diff(points, axis=2)[:, 1:-1], np.diff(points, axis=1)[:, :, 1:-1]
    middles = 0.5 * (points[:, 1:-1, 1:] + points[:, 1:-1, :-1]), 0.5 * (points[:, 1:, 1:-1] + points[:, :-1, 1:-1])
    weight, ratio = 0.5, 1.0
    for axis, (edge, middle) in enumerate(zip(edges, middles, strict=True)):
        before, after = (np.take(centres, range(*span), axis=1 + axis) for span in _spans(centres.shape[1 + axis]))
        below, above = np.abs(_cross(edge, middle - before)), np.abs(_cross(edge, after - middle))
        small, large = (np.take(volume, range(*span), axis=axis) for span in _spans(volume.shape[axis]))
        if edge.size:
            weight = min(weight, float((np.minimum(below, above) / (below + above)).min()))
            ratio = min(ratio, float((np.minimum(small, large) / np.maximum(small, large)).min()))
    return Checks(
        determinant=_determinant(edges, volume.shape),
        weight=weight,
        volume_ratio=ratio,
        skewness=measure_faces(mesh).skewness,
    )


def _determinant(edges: tuple[Array, Array], shape: tuple[int, ...]) -> float:
    """The smallest determinant of a cell; 0 for a cell without an inner face."""
    sums, lengths, counts = np.zeros((3, *shape)), np.zeros(shape), np.zeros(shape)
    for axis, edge in enumerate(edges):
        x, y = edge
        entries, length = np.stack([y * y, -x * y, x * x]), np.hypot(x, y)
        for first, last in _spans(shape[axis]):
            part = (slice(first, last), slice(None)) if axis == 0 else (slice(None), slice(first, last))
            sums[(slice(None), *part)] += entries
            lengths[part] += length
            counts[part] += 1.0
    mean = lengths / np.maximum(counts, 1.0)
    with np.errstate(all="ignore"):
        found = (sums[0] * sums[2] - sums[1] ** 2) / mean**4 / 8.0
    return float(np.where(counts > 0.0, found, 0.0).min())


def _spans(count: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """All cells of a row but the last, and all but the first."""
    return (0, count - 1), (1, count)


def _cross(one: Array, other: Array) -> Array:
    product: Array = one[0] * other[1] - one[1] * other[0]
    return product
