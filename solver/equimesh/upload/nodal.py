"""Samples at the nodes of a structured mesh: x, y and values of one shape ``(n_xi, n_eta)``."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from equimesh.domains.domain import Box
from equimesh.errors import SamplesError
from equimesh.fields.nodal_field import NodalField
from equimesh.inputs import real_array
from equimesh.meshes.mesh import Mesh

RIM_SHARE = 0.05
"""The share of the box around a domain with curved sides that the nodes of a mesh may leave out."""


def is_nodal(arrays: Mapping[str, Any]) -> bool:
    """Whether x, y and values are those of the nodes of a mesh, and not axes with a table."""
    return "x" in arrays and np.ndim(arrays["x"]) == 2


def nodal_samples(*, x: Any, y: Any, values: Any, box: Box | None = None) -> NodalField:
    """u from ``values`` at the nodes of a mesh; they must be those of a mesh of a domain with this ``box``.

    Raises :class:`~equimesh.errors.SamplesError` for other shapes, values that are not finite and another domain, and
    :class:`~equimesh.errors.InputError` for a folded mesh.
    """
    given = {"x": x, "y": y, "values": values}
    x, y, values = (real_array(array, name, ndim=2) for name, array in given.items())
    if not x.shape == y.shape == values.shape:
        shapes = f"{x.shape}, {y.shape} and {values.shape}"
        raise SamplesError(f"the nodes of a mesh have x, y and values of one shape, not {shapes}", field="values")
    for name, line, (low, high) in zip(("x", "y"), (x, y), box or (), strict=False):
        rim = RIM_SHARE * (high - low)
        if abs(line.min() - low) > rim or abs(line.max() - high) > rim:
            raise SamplesError("these are values at the nodes of a mesh of another domain", field=name)
    return NodalField(mesh=Mesh(x, y), values=values)
