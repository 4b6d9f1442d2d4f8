"""From a spec to the objects of the solver; input errors become problems with a pointer into the spec."""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

from equimesh import Blocks, Field, specs
from equimesh.domains.domain import Box
from equimesh.errors import InputError
from equimesh.solving.target import require_reachable
from equimesh_service.assembly.samples import Arrays, blocks_of, field_of
from equimesh_service.problems.problem import complaint_of, input_problem
from equimesh_service.spec.document import escape_token

Spec: TypeAlias = Mapping[str, Any]
"""A spec that fits the models, as plain JSON."""
Samples: TypeAlias = Path | Arrays
"""Stored samples, or those of this request."""
SamplesOf: TypeAlias = Callable[[str], Samples]
"""The samples with an id."""
_NUMBER = re.compile(r"\[(\d+)\]")


def build(spec: Spec, find: SamplesOf, field: Callable[[str, Box], Field] | None = None) -> specs.BuiltSpec:
    """The solver's objects of a spec; raises a 422 problem with pointers. ``field`` makes functions of samples."""

    @cache
    def samples(name: str, box: Box) -> Field:  # several functions of a monitor may name the same samples
        return field_of(find(name), box) if field is None else field(name, box)

    def mesh(name: str, settings: Mapping[str, Any]) -> Blocks:
        return blocks_of(find(name), settings)

    with translate_errors():
        return specs.build(spec, samples, mesh)


def check(spec: Spec, samples: Mapping[str, Samples]) -> specs.BuiltSpec:
    """The problem of :func:`build`; also raises for a target out of reach. ``samples`` are found by their ids."""
    built = build(spec, samples.__getitem__)
    if built.target is not None and built.target.error is not None:
        problem = built.grid_problem
        with translate_errors():
            require_reachable(built.target, monitor=problem.monitor, domain=problem.domain, boundary=problem.boundary)
    return built


def check_schwarz(spec: Spec) -> None:
    """Raise a 422 problem for an impossible grid, or for Schwarz settings that do not fit the grid."""
    with translate_errors():
        specs.build_schwarz(spec)


@contextmanager
def translate_errors(section: str = "") -> Iterator[None]:
    """Turn an input error of the solver into a 422 problem that points into ``section`` of the body."""
    try:
        yield
    except InputError as error:
        tokens = _NUMBER.sub(r".\1", error.field).split(".")  # blocks[2].cells of the solver is blocks/2/cells
        pointer = section + "".join(map(escape_token, filter(None, tokens)))
        raise input_problem([complaint_of(error, pointer)]) from None
