"""Fields of a step: what was sent, checked against the mesh whose nodes or cells it belongs to."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import SamplesError
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import real_array
from equimesh.io.npz import STEP
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.transfers.mesh_values import MAX_COMPONENTS, MeshValues
from equimesh_schema.sequences import FieldSettings, Location, Transfer

Array: TypeAlias = npt.NDArray[np.float64]

# The array of a file of fields that says how they are carried. No field can have this name.
_SETTINGS = "=settings"
_USUAL = ("spline", "nodes", None)


@dataclass(frozen=True, kw_only=True)
class StepField:
    """Values at the nodes or cells of the mesh of a step, and how they are carried to the next mesh.

    Once they are checked, they are an array of shape ``(n_xi, n_eta)`` at nodes, ``(n_xi - 1, n_eta - 1)`` in cells; a
    vector has a third axis, that of its components. On a mesh of blocks these are ``(n,)``, ``(m,)`` and a second axis.
    The conservative transfer keeps ``bounds``; None for the range of the values.
    """

    values: Any
    transfer: Transfer = "spline"
    location: Location = "nodes"
    bounds: tuple[float, float] | None = None

    @classmethod
    def of(cls, values: Any, settings: FieldSettings) -> "StepField":
        """The field of these settings."""
        bounds = None if settings.bounds is None else (settings.bounds[0], settings.bounds[1])
        return cls(values=values, transfer=settings.used_transfer, location=settings.location, bounds=bounds)

    def checked(self, mesh: Mesh | QuadMesh, name: str) -> "StepField":
        """The same field with checked values; raises :class:`~equimesh.errors.InputError`."""
        values = checked_values(self.values, mesh, name, location=self.location)
        if self.location == "cells" and self.transfer == "spline":
            message = f"{name} has averages of cells, which have no spline: send it with the transfer conservative"
            raise SamplesError(message, field=name)
        checked = replace(self, values=values)
        if self.bounds is not None:
            checked.mesh_values().on(mesh, name)
        return checked

    def mesh_values(self) -> MeshValues:
        """The field as the solver takes it."""
        return MeshValues(self.values, transfer=self.transfer, location=self.location, bounds=self.bounds)

    @property
    def settings(self) -> tuple[str, str, tuple[float, float] | None]:
        """Transfer, location and bounds."""
        return self.transfer, self.location, self.bounds


def checked_values(
    values: Any, mesh: Mesh | QuadMesh, name: str, *, location: Location = "nodes", vectors: bool = True
) -> Array:
    """Finite numbers at all nodes, or in all cells; raises :class:`~equimesh.errors.SamplesError`.

    With ``vectors`` there may be one more axis. The nodes of a mesh of blocks are rows of one value in JSON.
    """
    _refuse_not_finite(values, name)
    if isinstance(mesh, QuadMesh):
        return _in_one_row(values, mesh, name, location, vectors=vectors)
    array = real_array(values, name, ndim=dimensions(values) if vectors else 2)
    n_xi, n_eta = mesh.x.shape
    shapes: dict[Location, tuple[int, int]] = {"nodes": (n_xi, n_eta), "cells": (n_xi - 1, n_eta - 1)}
    if array.shape[:2] != shapes[location]:
        if not vectors and array.shape == shapes["cells"]:
            message = f"{name} has averages of the cells: a monitor needs its values at the {n_xi} x {n_eta} nodes"
            raise SamplesError(message, field=name)
        raise SamplesError(_other_shape(name, array.shape, shapes, location), field=name)
    if array.ndim == 3 and not 1 <= array.shape[2] <= MAX_COMPONENTS:
        message = f"{name} has vectors of {array.shape[2]} components: 1 to {MAX_COMPONENTS} are allowed"
        raise SamplesError(message, field=name)
    return _bounded(array, name)


def _in_one_row(values: Any, mesh: QuadMesh, name: str, location: Location, *, vectors: bool) -> Array:
    """The values of :func:`checked_values` on a mesh of blocks, of shape ``(n,)`` or ``(n, components)``."""
    ndim = values.ndim if isinstance(values, np.ndarray) and values.ndim in (1, 3) else dimensions(values)
    array = real_array(values, name, ndim=ndim)
    if array.ndim > 1 and array.shape[1] == 1:
        array = array.reshape(len(array), *array.shape[2:])
    counts: dict[Location, int] = {"nodes": len(mesh.points), "cells": len(mesh.cells)}
    if len(array) != counts[location]:
        found = next((place for place, count in counts.items() if len(array) == count), None)
        hint = "" if found is None else f"; these are as many as the {found}"
        message = f"{name} has {len(array)} values, and the mesh has {counts[location]} {location}{hint}"
        raise SamplesError(message, field=name)
    if array.ndim > 1 + vectors or (array.ndim == 2 and not 1 <= array.shape[1] <= MAX_COMPONENTS):
        most = f"1 to {MAX_COMPONENTS} components" if vectors else "one number"
        raise SamplesError(f"{name} has the shape {array.shape}: {most} of each of the {location}", field=name)
    return _bounded(array, name)


def _bounded(array: Array, name: str) -> Array:
    """The values, none of them too large to compute with; raises :class:`~equimesh.errors.SamplesError`."""
    large = np.abs(array) > LIMITS.magnitude
    if large.any():
        place = tuple(np.argwhere(large)[0])
        shown = "".join(f"[{index}]" for index in place)
        raise SamplesError(
            f"{name}{shown} = {array[place]:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale it",
            field=name,
        )
    return array


def write_fields(path: Path, fields: Mapping[str, StepField]) -> None:
    """Write checked fields to an npz file, with the settings of those that do not have the usual ones."""
    unusual = {name: field.settings for name, field in fields.items() if field.settings != _USUAL}
    arrays: dict[str, Any] = {name: field.values for name, field in fields.items()}
    if unusual:
        arrays[_SETTINGS] = np.array(json.dumps(unusual))
    np.savez(path, **arrays)


def read_fields(path: Path) -> dict[str, StepField]:
    """The fields in a file of :func:`write_fields`."""
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    unusual = json.loads(str(arrays.pop(_SETTINGS, "{}")))
    fields = {}
    for name, values in arrays.items():
        transfer, location, bounds = unusual.get(name, _USUAL)
        bounds = None if bounds is None else (bounds[0], bounds[1])
        fields[name] = StepField(values=values, transfer=transfer, location=location, bounds=bounds)
    return fields


def read_velocity(path: Path) -> list[list[list[float]]] | None:
    """The displacement of the nodes in the npz file of a step; None for another mesh. Blocks have rows of one node."""
    with np.load(path, allow_pickle=False) as file:
        name = json.loads(file[STEP].tobytes())["velocity"] if STEP in file.files else None
        if name is None:
            return None
        moves = file[name]
    found: list[list[list[float]]] = (moves if moves.ndim == 3 else moves[:, None]).tolist()
    return found


def _refuse_not_finite(values: Any, name: str) -> None:
    """Say of an array that is not finite where the first such value is."""
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return
    bad = ~np.isfinite(values)
    if bad.any():
        place = tuple(int(index) for index in np.argwhere(bad)[0])
        found = "NaN" if np.isnan(values[place]) else "infinite"
        shown = "".join(f"[{index}]" for index in place)
        raise SamplesError(
            f"{name}{shown} is {found} ({int(bad.sum())} of {values.size} values are not finite), as from a solver that"
            " diverged: go on from the mesh of this step, for instance with a smaller time step",
            field=name,
        )


def dimensions(values: Any) -> int:
    """The dimensions that values must have: three for vectors, else two."""
    if isinstance(values, np.ndarray):
        return 3 if values.ndim == 3 else 2
    first = values[0] if isinstance(values, list) and values else None
    return 3 if isinstance(first, list) and first and isinstance(first[0], list) else 2


def _other_shape(
    name: str, shape: tuple[int, ...], shapes: Mapping[Location, tuple[int, int]], location: Location
) -> str:
    """The sentence about values of another shape."""
    n, m = shapes[location]
    other: Location = "cells" if location == "nodes" else "nodes"
    if shape[:2] == shapes[other]:
        return f"{name} has one value for each of the {other}, and is sent as {location}: give it the location {other}"
    hint = "; transpose it" if shape[:2] == (m, n) else ""
    return (
        f"{name} has shape {shape}, but the mesh has {n} x {m} {location}: one value is needed for each, xi first{hint}"
    )
