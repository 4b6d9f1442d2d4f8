"""Meshes for the solvers of others: arrays in, no file, and their solutions back.

``__all__`` is the table of contents. Meshes of ``equimesh`` and ``equimesh_client`` have the methods of
:class:`Coupled`: ``mesh.to_skfem()``, ``mesh.to_fipy()`` and so on.
"""

from typing import TYPE_CHECKING, Any

from equimesh_coupling.errors import BadValues, CouplingError, EquimeshError, MissingLibrary, OldLibrary
from equimesh_coupling.errors import deferred as _deferred

if TYPE_CHECKING:
    from equimesh_coupling.coupled import Coupled
    from equimesh_coupling.elements import element_points
    from equimesh_coupling.goals import Goal, WithAdjoint
    from equimesh_coupling.parts import MeshParts
    from equimesh_coupling.precice import PreciceMesh
    from equimesh_coupling.values import CellAverages, ErrorIndicator, cell_values, element_values, node_values


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """A name of ``__all__``, whose module is imported at its first use: errors alone need no NumPy."""
        return _deferred(__name__, name)


__all__ = [  # noqa: RUF022 - grouped by noun
    # Meshes that other libraries take
    "Coupled",
    "MeshParts",
    "PreciceMesh",
    # What a solver returns
    "node_values",
    "element_values",
    "element_points",
    "cell_values",
    "CellAverages",
    "ErrorIndicator",
    "Goal",
    "WithAdjoint",
    # Errors, drawn as a tree in ``equimesh_coupling/errors.py``
    "EquimeshError",
    "CouplingError",
    "MissingLibrary",
    "OldLibrary",
    "BadValues",
]
