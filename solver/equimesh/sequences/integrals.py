"""What a step says of the integrals of the fields that it carried."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.transfers.integrals import integral
from equimesh.transfers.mesh_values import MeshValues

# A relative change of an integral that deserves a sentence: rounding is far less.
MAX_SILENT_CHANGE = 1e-12


def about_integrals(
    meshes: tuple[Mesh | QuadMesh, Mesh | QuadMesh], given: Mapping[str, MeshValues], carried: Mapping[str, Array]
) -> Iterator[str]:
    """Sentences about integrals that were not kept, from the mesh before to the new one."""
    for name, field in given.items():
        change = _change(meshes[0], meshes[1], field, carried[name]) if field.transfer == "conservative" else 0.0
        if change > MAX_SILENT_CHANGE:
            yield (
                f"The integral of {name} changed by {change:.1e} of itself: straight edges cut a curved side"
                " differently in the two meshes, and the bounds leave no room for the difference."
            )


def _change(old: Mesh | QuadMesh, new: Mesh | QuadMesh, field: MeshValues, carried: Array) -> float:
    """The largest relative change of the integral of a component."""
    values, largest = np.asarray(field.values, dtype=float), 0.0
    for index in np.ndindex(*values.shape[len(old.node_shape) :]):
        before = integral(old, values[(..., *index)], field.location)
        size = integral(old, np.abs(values[(..., *index)]), field.location)
        after = integral(new, carried[(..., *index)], field.location)
        largest = max(largest, abs(after - before) / size if size > 0.0 else 0.0)
    return largest
