"""Steps of many bytes of JSON: their values at the nodes are taken out into a file, by a side worker."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from equimesh.errors import InputError
from equimesh.inputs import real_array
from equimesh_service.problems.problem import complaint_of, input_problem
from equimesh_service.spec.document import escape_token, parse
from equimesh_service.spec.sources import ExpressionSource
from equimesh_service.spec.step import StepSpec
from equimesh_service.spec.strict import validate


@dataclass(frozen=True)
class ShortStep:
    """A step without its values at the nodes, which an npz file has: of u under "u", of the fields under numbers.

    ``u`` is an expression, or None for values at the nodes; ``sent`` is the JSON of the expression.
    """

    step: int
    u: ExpressionSource | None
    names: tuple[str, ...]
    sent: Mapping[str, Any]

    def fields(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """The values of the fields by their names, from the arrays of the file."""
        return {name: arrays[str(number)] for number, name in enumerate(self.names)}


def shorten_step(text: Path, target: Path, most_values: int) -> ShortStep:
    """Read the JSON of a step, and write its values to the npz file ``target``; raises 400, 413 and 422 problems."""
    sent = parse(text.read_bytes(), most_values)
    spec = validate(StepSpec, sent)
    arrays: dict[str, Any] = {
        str(number): _array(values, name, f"/fields{escape_token(name)}")
        for number, (name, values) in enumerate(spec.fields.items())
    }
    u, names, formula = spec.u, tuple(spec.fields), None
    if isinstance(u, ExpressionSource):
        formula = u
    else:
        arrays["u"] = _array(u.nodes, "u", "/u/nodes")
    with target.open("wb") as file:
        np.savez(file, **arrays)
    return ShortStep(spec.step, formula, names, {} if formula is None else {"u": sent["u"]})


def _array(values: Any, name: str, pointer: str) -> Any:
    try:
        return real_array(values, name, ndim=2)
    except InputError as error:
        raise input_problem([complaint_of(error, pointer)]) from None
