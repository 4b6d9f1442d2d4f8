"""The formulas of a problem that were typed in another spelling than that of the language."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass

from equimesh.domains.curve import FormulaPath
from equimesh.fields.expression import Expression


def understood(problem: object) -> dict[str, str]:
    """The formulas of a problem as they were understood, by their place in it: ``{"monitor.u": "2*x"}`` for ``2x``.

    Those that are in the language itself are left out.
    """
    return dict(_differences(problem, ""))


def _differences(part: object, place: str) -> Iterator[tuple[str, str]]:
    if isinstance(part, Expression):
        if part.understood != part.text:
            yield place, part.understood
    elif isinstance(part, FormulaPath):
        for name, typed, read in zip("xy", (part.x, part.y), part.understood, strict=True):
            if read != typed:
                yield f"{place}.{name}", read
    elif isinstance(part, Mapping):
        for key, value in part.items():
            yield from _differences(value, f"{place}.{key}")
    elif isinstance(part, tuple) and part and is_dataclass(part[0]):
        for number, value in enumerate(part):
            yield from _differences(value, f"{place}[{number}]")
    elif is_dataclass(part) and not isinstance(part, type):
        for field in fields(part):
            if field.init:
                inner = place if field.name == "path" else f"{place}.{field.name}".removeprefix(".")
                yield from _differences(getattr(part, field.name), inner)
