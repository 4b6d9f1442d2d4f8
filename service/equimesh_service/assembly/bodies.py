"""Specs and steps of many bytes, whose numbers are taken out into files, and requests in one npz."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError, SamplesError
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import AT_PLACES, real_array, shape_of, shaped_array
from equimesh.io.reading.bounds import open_zip
from equimesh.meshes.mesh import Mesh
from equimesh.specs.spec import BuiltSpec
from equimesh.transfers.mesh_values import MAX_COMPONENTS, MeshValues
from equimesh_schema.sequences import FieldSettings, FieldSource, FieldSpec, Location, NodesSource, StepSpec, Transfer
from equimesh_schema.sources import (
    ExpressionSource,
    SamplesSource,
)
from equimesh_service.assembly.problem import check, translate_errors
from equimesh_service.assembly.samples import canonical_arrays, write
from equimesh_service.assembly.upload import Upload
from equimesh_service.problems.problem import Problem, complaint_of, input_problem, problem_at, repointed
from equimesh_service.spec.document import MAX_PLAIN_VALUES, escape_token, parse, sent_pointer
from equimesh_service.spec.mesh import CheckedSpec, read_spec
from equimesh_service.spec.monitors import with_functions
from equimesh_service.spec.strict import validate

# The array with the spec.
SPEC = "spec"
# The most bytes of that array: 1 MiB of text, four bytes for each character.
MAX_SPEC_BYTES = 4 * 1024 * 1024
_REMEDY = "write it with numpy.savez(file, spec=json.dumps(spec), x=x, y=y, values=values)"
# The header of an npy file of texts or bytes, as NumPy writes it; other headers take NumPy long to understand.
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '[<|](?P<kind>[USu])(?P<size>[0-9]{1,8})', 'fortran_order': False, "
    rb"'shape': \((?P<shape>|1,|[0-9]{1,8},)\), \} *\n",
    re.DOTALL,
)


def unpack(data: bytes) -> tuple[bytes, Upload | None]:
    """The bytes of the spec, and the samples, where there are other arrays; raises 400 and 422 problems."""
    with translate_errors(), open_zip(data, "npz", MAX_SPEC_BYTES, _REMEDY) as members:
        if f"{SPEC}.npy" not in members.names:
            raise Problem("malformed-body", f"The npz has no array {SPEC!r}: {_REMEDY}.")
        spec = _text(members.read(f"{SPEC}.npy"))
        others = len(members.names) > 1
    return spec, Upload(data, "samples.npz") if others else None


def _text(member: bytes) -> bytes:
    """The UTF-8 bytes of a text that was saved as an array: one text, or its bytes."""
    head = _HEADER.match(member)
    is_text = head is not None and head["kind"] != b"u" and head["shape"] in (b"", b"1,")
    is_bytes = head is not None and (head["kind"], head["size"]) == (b"u", b"1")
    if head is None or not (is_text or is_bytes):
        raise SamplesError("the array spec must be one text, or its bytes", field=SPEC)
    content = member[head.end() :]
    width = {b"U": 4, b"S": 1, b"u": 1}[head["kind"]]
    number = int(head["shape"][:-1] or 0) if is_bytes else int(head["size"])
    if len(content) != width * number:
        raise SamplesError("the array spec does not have its stated length", field=SPEC)
    if head["kind"] != b"U":
        return content.rstrip(b"\0")
    try:
        return content.decode("utf-32-le").rstrip("\0").encode()
    except UnicodeError:
        raise SamplesError("the array spec is not a text", field=SPEC) from None


# Texts of a spec up to this size are read in the process of the service: within 20 ms whatever they contain.
MAX_SHORT_BYTES = 256 * 1024
# Values of one scattered sample: x, y, u, and the list of the point.
_VALUES_OF_SAMPLE = 4


@dataclass(frozen=True, kw_only=True)
class SpecLimits:
    """The limits of the service that are checked before samples are read. ``product`` is what is limited, in words."""

    max_points: int
    max_samples: int
    product: str = "a mesh of this service"

    @property
    def most_values(self) -> int:
        """The most values of the JSON of a spec."""
        return MAX_PLAIN_VALUES + _VALUES_OF_SAMPLE * self.max_samples

    def check(self, spec: CheckedSpec) -> None:
        """Raise a 422 problem for a target of more points than the service takes, and for more samples."""
        target = spec.canonical["target"]
        if target is not None and (target["max_points"] or 0) > self.max_points:
            message = f"{self.product} has at most {self.max_points} points: request fewer"
            raise problem_at("/target/max_points", message)
        for pointer, source in spec.sources.items():
            if isinstance(source, SamplesSource):
                self.check_number(source.count, f"{pointer}/{source.key}/{source.COUNTED}")

    def check_number(self, number: int, pointer: str) -> None:
        """Raise a 422 problem at ``pointer`` for more samples than the service takes."""
        if number > self.max_samples:
            message = f"{number} samples; this service takes at most {self.max_samples}: send fewer"
            raise problem_at(pointer, message)


@dataclass(frozen=True)
class ShortSpec:
    """A spec, and the samples that were taken out of it: they are in files in ``folder``.

    ``summaries`` has their summaries by the names that the spec has for them. ``built`` is the problem, where the
    monitor is known to fit its domain.
    """

    spec: CheckedSpec
    folder: Path = Path()
    summaries: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    built: BuiltSpec | None = None

    @property
    def files(self) -> dict[str, Path]:
        """The files of the samples, by their names in the spec."""
        return {name: _file(self.folder, name) for name in self.summaries}


def shorten(text: Path, folder: Path, limits: SpecLimits) -> ShortSpec:
    """Read the JSON of a spec, and write its samples to files in ``folder``; raises 400, 413 and 422 problems."""
    document = parse(text.read_bytes(), limits.most_values)
    try:
        return _shorten(read_spec(document).with_limit(limits.max_points), folder, limits)
    except Problem as problem:
        if not problem.errors:
            raise
        raise repointed(problem, partial(sent_pointer, document)) from None


def _shorten(spec: CheckedSpec, folder: Path, limits: SpecLimits) -> ShortSpec:
    limits.check(spec)
    built = None if spec.stored else check(spec.canonical, {})
    document, summaries = {**spec.canonical}, {}
    for pointer, source in spec.sources.items():
        if isinstance(source, SamplesSource):
            name = f"inline-{secrets.token_hex(8)}"  # no other spec can name it
            summaries[name] = _write(source, pointer, _file(folder, name))
            document = _replaced(document, pointer.split("/")[1:], {"samples": name})
    return ShortSpec(replace(read_spec(document), target_pointer=spec.target_pointer), folder, summaries, built)


def _file(folder: Path, name: str) -> Path:
    return folder / f"{name}.npz"


def _write(source: SamplesSource, pointer: str, path: Path) -> dict[str, Any]:
    """Write samples to a file; returns their summary."""
    with translate_errors(f"{pointer}/{source.key}"), path.open("wb") as file:
        return write(canonical_arrays(vars(source.samples)), file)


def _replaced(document: Any, tokens: list[str], value: Any) -> Any:
    """A copy of a JSON value with another value at a place in it."""
    if not tokens:
        return value
    token, *others = tokens
    if isinstance(document, list):
        inner = _replaced(document[int(token)], others, value)
        return [inner if place == int(token) else member for place, member in enumerate(document)]
    return {**document, token: _replaced(document[token], others, value)}


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
    def of(cls, values: Any, settings: FieldSettings) -> StepField:
        """The field of these settings."""
        bounds = None if settings.bounds is None else (settings.bounds[0], settings.bounds[1])
        return cls(values=values, transfer=settings.used_transfer, location=settings.location, bounds=bounds)

    def checked(self, mesh: Mesh, name: str) -> StepField:
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


def checked_values(values: Any, mesh: Mesh, name: str, *, location: Location = "nodes", vectors: bool = True) -> Array:
    """Finite numbers at all nodes, or in all cells; raises :class:`~equimesh.errors.SamplesError`.

    With ``vectors`` there may be one more axis. The nodes of a mesh of blocks are rows of one value in JSON.
    """
    _refuse_not_finite(values, name)
    if not mesh.is_grid:
        return _in_one_row(values, mesh, name, location, vectors=vectors)
    shapes, other = {"nodes": mesh.node_shape, "cells": mesh.cell_shape}, "cells" if location == "nodes" else "nodes"
    if shape_of(values)[:2] == shapes[other]:
        is_sent = f"and is sent as {location}: give it the location {other}"
        advice = is_sent if vectors else "and a monitor needs one for each of the nodes"
        raise SamplesError(f"{name} has one value for each of the {other}, {advice}", field=name)
    array = shaped_array(values, name, shapes[location], AT_PLACES[location], vectors=vectors)
    if array.ndim == 3 and not 1 <= array.shape[2] <= MAX_COMPONENTS:
        message = f"{name} has vectors of {array.shape[2]} components: 1 to {MAX_COMPONENTS} are allowed"
        raise SamplesError(message, field=name)
    return _bounded(array, name)


def _in_one_row(values: Any, mesh: Mesh, name: str, location: Location, *, vectors: bool) -> Array:
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


def field_arrays(fields: Mapping[str, StepField]) -> dict[str, Any]:
    """The arrays of an npz file of checked fields, with the settings of those that do not have the usual ones."""
    unusual = {name: field.settings for name, field in fields.items() if field.settings != _USUAL}
    arrays: dict[str, Any] = {name: field.values for name, field in fields.items()}
    if unusual:
        arrays[_SETTINGS] = np.array(json.dumps(unusual))
    return arrays


def read_fields(source: Path | BinaryIO) -> dict[str, StepField]:
    """The fields in a file of :func:`field_arrays`."""
    with np.load(source, allow_pickle=False) as file:
        arrays = dict(file)
    unusual = json.loads(str(arrays.pop(_SETTINGS, "{}")))
    fields = {}
    for name, values in arrays.items():
        transfer, location, bounds = unusual.get(name, _USUAL)
        bounds = None if bounds is None else (bounds[0], bounds[1])
        fields[name] = StepField(values=values, transfer=transfer, location=location, bounds=bounds)
    return fields


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


@dataclass(frozen=True)
class ShortStep:
    """A step without its values, which an npz file has: of u under "u", of the fields under numbers.

    ``u`` is None for values at the nodes, and where there is none. The functions of the ``monitor`` that are values at
    nodes name arrays of the file. ``sent`` is the JSON of u and of the monitor, ``pointers`` are those of the values of
    fields, ``motion`` says how the mesh moves.
    """

    step: int
    u: ExpressionSource | FieldSource | None
    names: tuple[str, ...]
    sent: Mapping[str, Any]
    settings: tuple[FieldSettings, ...] = ()
    monitor: Mapping[str, Any] | None = None
    pointers: Mapping[str, str] = field(default_factory=dict)
    motion: Mapping[str, Any] = field(default_factory=dict)

    def fields(self, arrays: Mapping[str, Any]) -> dict[str, tuple[Any, FieldSettings]]:
        """The values and settings of the fields by their names, from the arrays of the file."""
        named = zip(self.names, self.settings, strict=True)
        return {name: (arrays[str(number)], settings) for number, (name, settings) in enumerate(named)}


def shorten_step(text: Path, target: Path, most_values: int) -> ShortStep:
    """Read the JSON of a step, and write its values to the npz file ``target``; raises 400, 413 and 422 problems."""
    sent = parse(text.read_bytes(), most_values)
    spec = validate(StepSpec, sent)
    arrays: dict[str, Any] = {}
    for number, (name, given) in enumerate(spec.fields.items()):
        values, pointer = values_of(given), pointer_of(name, given)
        arrays[str(number)] = _array(values, name, pointer)
    u, formula = spec.u, None
    if isinstance(u, NodesSource):
        arrays["u"] = _array(u.nodes, "u", "/u/nodes")
    else:
        formula = u

    def take_out(pointer: str, source: Any) -> Any:
        if not isinstance(source, Mapping) or source.keys() != {"nodes"}:
            return source
        arrays[pointer] = _array(source["nodes"], pointer.rpartition("/")[2], f"{pointer}/nodes")
        return {"nodes": pointer}

    monitor = None if spec.monitor is None else with_functions(spec.monitor, take_out)
    with target.open("wb") as file:
        np.savez(file, **arrays)
    kept = {"u": sent["u"]} if formula is not None else {}
    kept |= {"monitor": monitor} if monitor is not None else {}
    settings = tuple(map(settings_of, spec.fields.values()))
    pointers = {name: pointer_of(name, given) for name, given in spec.fields.items()}
    return ShortStep(spec.step, formula, tuple(spec.fields), kept, settings, monitor, pointers, spec.given)


def values_of(given: Any) -> Any:
    """The values of a field of a step."""
    return given.values if isinstance(given, FieldSpec) else given


def settings_of(given: Any) -> FieldSettings:
    """How a field of a step is carried."""
    if isinstance(given, FieldSpec):
        return FieldSettings(transfer=given.transfer, location=given.location, bounds=given.bounds)
    return FieldSettings()


def pointer_of(name: str, given: Any) -> str:
    """The JSON pointer of the values of a field."""
    return f"/fields{escape_token(name)}" + ("/values" if isinstance(given, FieldSpec) else "")


def _array(values: Any, name: str, pointer: str) -> Any:
    try:
        return real_array(values, name, ndim=dimensions(values))
    except InputError as error:
        raise input_problem([complaint_of(error, pointer)]) from None
