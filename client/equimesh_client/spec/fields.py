"""Fields of a step of a sequence, how they are carried to the next mesh, and how the mesh moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
import numpy.typing as npt

from equimesh_client.errors import BadArgument
from equimesh_coupling.parts import HasParts
from equimesh_coupling.values import CellAverages, cell_values, is_field, node_values

Array: TypeAlias = npt.NDArray[np.float64]
Transfer: TypeAlias = Literal["spline", "conservative"]
Location: TypeAlias = Literal["nodes", "cells"]


@dataclass(frozen=True, eq=False)
class Field:
    """Values on the mesh of a step, and the way they are carried to the next mesh.

    ``values`` has the shape ``(n_xi, n_eta)`` at nodes, ``(n_xi - 1, n_eta - 1)`` for averages of cells, and one more
    axis for the components of vectors; on blocks these are ``(n,)``, ``(m,)`` and one more axis. ``transfer`` is
    ``"spline"``, smooth and of fourth order, or ``"conservative"``, which keeps the integral and the ``bounds``, by
    default the range of the values; None stands for the spline at nodes, and the conservative one in cells.
    ``location`` is ``"nodes"`` or ``"cells"``.
    """

    values: npt.ArrayLike
    transfer: Transfer | None = None
    location: Location = "nodes"
    bounds: tuple[float, float] | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """The JSON of the transfer, the location and the bounds, where they are not the usual ones."""
        given: dict[str, Any] = {} if self.transfer is None else {"transfer": str(self.transfer)}
        given |= {} if self.location == "nodes" else {"location": str(self.location)}
        return given if self.bounds is None else {**given, "bounds": [float(end) for end in self.bounds]}


def read_fields(
    fields: Mapping[str, object] | None, mesh: HasParts
) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
    """The arrays of fields by their names, and the settings of those that have some.

    A field is an array, a :class:`Field`, a field of another library, or its ``CellAverages``. Raises
    :class:`BadArgument` for values that are no array of numbers, and ``BadValues`` for a field of another mesh.
    """
    if not isinstance(fields, Mapping | None):
        raise BadArgument(f'fields = {fields!r:.80}: give them by their names, as {{"pressure": values}}')
    given = {name: _field_of(field, mesh) for name, field in (fields or {}).items()}
    arrays = {name: number_array(name, field.values, mesh) for name, field in given.items()}
    return arrays, {name: field.settings for name, field in given.items() if field.settings}


def _field_of(field: Any, mesh: HasParts) -> Field:
    if isinstance(field, CellAverages):
        return Field(cell_values(field, mesh), "conservative", "cells")
    return field if isinstance(field, Field) else Field(field)


def number_array(name: str, values: Any, mesh: HasParts) -> Array:
    """An array of numbers: those given, one for each node in one row, or those of a field of another library.

    Raises :class:`BadArgument` for anything else.
    """
    if is_field(values) or isinstance(values, CellAverages):
        return node_values(values, mesh)
    try:
        array = np.asarray(values)
        if np.iscomplexobj(array):
            raise TypeError("it is complex")
        array = array.astype(np.float64, copy=False)
        parts = mesh.mesh_parts()
        return array.reshape(parts.node_shape) if array.shape == (len(parts.points),) else array
    except (TypeError, ValueError) as error:
        raise BadArgument(f"{name} is not an array of real numbers: {error}") from error


# How the mesh of a sequence moves.


class Motion(TypedDict, total=False):
    """How the mesh of a sequence moves, from a step on. What is left out stays as it was."""

    smoothing: float
    """The share of the mesh before in each new mesh, from 0 (at first) to 0.9. Raise it where meshes jitter."""
    max_move: float
    """How far nodes may move in a step, in cells of the mesh before. At first: 1."""
    outrun: Literal["substeps", "refuse"]
    """What happens where nodes would move farther: ``"substeps"`` (at first) tries other starts, and meshes in between,
    where the error has risen; ``"refuse"`` raises :class:`MeshFailed`, and the sequence stays as it was.
    """


def motion_json(motion: Motion) -> dict[str, Any]:
    """The JSON of the settings; raises :class:`TypeError` for others, which names the nearest one."""
    given: Mapping[str, Any] = motion
    names = [*Motion.__annotations__]
    for name in given:
        if name not in names:
            nearest = get_close_matches(name, names, n=1)
            advice = f"did you mean {nearest[0]!r}?" if nearest else f"it has {', '.join(names)}"
            raise TypeError(f"step() has no option {name!r}; {advice}")
    return {name: value if isinstance(value, str) else float(value) for name, value in given.items()}
