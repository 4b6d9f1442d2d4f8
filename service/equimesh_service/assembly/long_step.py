"""Steps of many bytes of JSON: their values are taken out into a file, by a side worker."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import real_array
from equimesh_schema.sequences import FieldSettings, FieldSource, FieldSpec, NodesSource, StepSpec
from equimesh_schema.sources import ExpressionSource
from equimesh_service.assembly.step_fields import dimensions
from equimesh_service.problems.problem import complaint_of, input_problem
from equimesh_service.spec.document import escape_token, parse
from equimesh_service.spec.monitors import with_functions
from equimesh_service.spec.strict import validate


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
