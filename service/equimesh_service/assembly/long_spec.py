"""Specs of many bytes: nearly all of these are samples, which are taken out of the spec into files.

This runs in a side worker, since it takes seconds for a million samples, and memory many times the size of the text.
The service gets a short spec that names the samples, as one with uploaded samples does.
"""

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from equimesh_schema.sources import AnySource, SamplesSource
from equimesh_service.assembly.problem import packed_check, translate_errors
from equimesh_service.assembly.samples import canonical_arrays, write
from equimesh_service.problems.problem import Problem, problem_at, repointed
from equimesh_service.spec.document import MAX_PLAIN_VALUES, parse, sent_pointer
from equimesh_service.spec.mesh import CheckedSpec, read_spec

# Texts of a spec up to this size are read in the process of the service: within 20 ms whatever they contain.
MAX_SHORT_BYTES = 256 * 1024
# Values of one scattered sample: x, y, u, and the list of the point.
_VALUES_OF_SAMPLE = 4


@dataclass(frozen=True, kw_only=True)
class SpecLimits:
    """The limits of the service that are checked before samples are read."""

    max_points: int
    max_samples: int

    @property
    def most_values(self) -> int:
        """The most values of the JSON of a spec."""
        return MAX_PLAIN_VALUES + _VALUES_OF_SAMPLE * self.max_samples

    def check(self, sources: Mapping[str, AnySource]) -> None:
        """Raise a 422 problem for more samples than the service takes."""
        for pointer, source in sources.items():
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

    ``summaries`` has their summaries by the names that the spec has for them. ``packed`` is the problem, where the
    monitor is known to fit its domain.
    """

    spec: CheckedSpec
    folder: Path = Path()
    summaries: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    packed: bytes | None = None

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
    limits.check(spec.sources)
    packed = None if spec.stored else packed_check(spec.canonical, {})
    document, summaries = {**spec.canonical}, {}
    for pointer, source in spec.sources.items():
        if isinstance(source, SamplesSource):
            name = f"inline-{secrets.token_hex(8)}"  # no other spec can name it
            summaries[name] = _write(source, pointer, _file(folder, name))
            document = _replaced(document, pointer.split("/")[1:], {"samples": name})
    return ShortSpec(read_spec(document), folder, summaries, packed)


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
