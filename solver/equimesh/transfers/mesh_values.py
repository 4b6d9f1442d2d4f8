"""Values that belong to a mesh: where they are, and how they are carried to the next mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError, SamplesError
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import AT_PLACES, shape_of, shaped_array
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array

Transfer: TypeAlias = Literal["spline", "conservative"]
Location: TypeAlias = Literal["nodes", "cells"]

TRANSFERS: tuple[Transfer, ...] = ("spline", "conservative")
LOCATIONS: tuple[Location, ...] = ("nodes", "cells")
# The share of the range between its bounds by which a value may be beyond them.
MAX_ROUNDING = 1e-12
# Components, at most, of one field.
MAX_COMPONENTS = 16


@dataclass(frozen=True, eq=False, repr=False)
class MeshValues:
    """Values on a mesh, and the way that they are carried to another one by :func:`~equimesh.transfers.transfer`.

    ``values`` has the shape ``mesh.node_shape`` at nodes, ``mesh.cell_shape`` for averages over cells: on a grid
    ``(n_xi, n_eta)`` and ``(n_xi - 1, n_eta - 1)``, on blocks the number of nodes and of cells. A vector has one more
    axis, of at most 16 components, each of which is carried by itself. ``transfer`` is ``"spline"`` for
    smooth fields at nodes, ``"conservative"`` where the integral or bounds count; averages need the latter. ``bounds``,
    least and largest value, hold for the conservative transfer; without them the range of the values does.

    Raises :class:`~equimesh.errors.InputError` for other words, and for bounds that do not increase.
    """

    values: npt.ArrayLike
    transfer: Transfer = field(default="spline", kw_only=True)
    location: Location = field(default="nodes", kw_only=True)
    bounds: tuple[float, float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        for name, known in (("transfer", TRANSFERS), ("location", LOCATIONS)):
            if getattr(self, name) not in known:
                raise InputError(f"{name} = {getattr(self, name)!r}: choose {known[0]!r} or {known[1]!r}", field=name)
        if self.location == "cells" and self.transfer == "spline":
            raise InputError(
                "averages over cells are carried with their integrals: give transfer='conservative', or values at"
                " nodes",
                field="transfer",
            )
        if self.bounds is not None:
            _check_bounds(self.bounds, self.transfer)

    def on(self, mesh: Mesh, name: str) -> Array:
        """The checked values on ``mesh``; raises :class:`~equimesh.errors.SamplesError` with the field ``name``."""
        shapes, axes = {"nodes": mesh.node_shape, "cells": mesh.cell_shape}, len(mesh.node_shape)
        other = "cells" if self.location == "nodes" else "nodes"
        is_other = shape_of(self.values)[:axes] == shapes[other]
        hint = f"; for values of this shape give location='{other}'" if is_other else ""
        what = AT_PLACES[self.location]
        checked = shaped_array(self.values, name, shapes[self.location], what, hint=hint, vectors=True)
        if checked.ndim > axes and not 1 <= checked.shape[axes] <= MAX_COMPONENTS:
            raise SamplesError(
                f"{name} has {checked.shape[axes]} components: a field has 1 to {MAX_COMPONENTS}", field=name
            )
        if self.bounds is not None and _is_beyond(checked, self.bounds):
            raise SamplesError(
                f"{name} lies between {checked.min():.6g} and {checked.max():.6g}, its bounds are {self.bounds[0]:g}"
                f" and {self.bounds[1]:g}: give bounds that hold for the values",
                field=name,
            )
        if np.abs(checked).max() > LIMITS.magnitude:
            raise SamplesError(f"{name} has values of more than {LIMITS.magnitude:g} in size: rescale it", field=name)
        return checked


def mesh_values(field: Any) -> MeshValues:
    """The field as it is; an array as values at nodes that are carried by splines."""
    return field if isinstance(field, MeshValues) else MeshValues(field)


def _is_beyond(values: Array, bounds: tuple[float, float]) -> bool:
    """Whether values are beyond their bounds by more than the rounding of a solver."""
    slack = MAX_ROUNDING * (bounds[1] - bounds[0])
    return bool(values.min() < bounds[0] - slack or values.max() > bounds[1] + slack)


def _check_bounds(bounds: Any, transfer: str) -> None:
    if transfer != "conservative":
        raise InputError("only the conservative transfer keeps bounds: give transfer='conservative'", field="bounds")
    are_numbers = isinstance(bounds, Sequence | np.ndarray) and all(isinstance(end, Real) for end in bounds)
    if not (are_numbers and len(bounds) == 2 and bounds[0] < bounds[1]):
        raise InputError(
            f"bounds = {bounds!r}: give two numbers, the least and the largest value, in this order", field="bounds"
        )
