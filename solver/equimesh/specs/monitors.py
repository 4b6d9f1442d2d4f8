"""Monitors of a document."""

from collections.abc import Callable
from functools import partial, wraps
from inspect import signature
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain
from equimesh.equations.block_problem import BlockProblem
from equimesh.errors import InputError
from equimesh.io.write import Cells
from equimesh.monitors.arc_length import ArcLength
from equimesh.monitors.auto import Auto
from equimesh.monitors.curvature import Curvature
from equimesh.monitors.intersection import Intersection
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.nodal_solution import NodalSolution
from equimesh.monitors.smoothed import Smoothed
from equimesh.monitors.tensor import Tensor, Weight
from equimesh.specs.document import ByKind, Reader, Record, Refusing, as_given, flag, number, optional, several, within
from equimesh.specs.sources import FindSamples, build_field
from equimesh_schema.document import OneOf, key_of, kind_of, one_of, types_of
from equimesh_schema.monitors import MONITORS, MonitorDocument
from equimesh_schema.sources import SOURCES

SETTINGS: dict[Any, Reader] = {float: number, bool: flag}
"""The readers of settings by their types; those of other types are checked when the monitor is built."""
MAKERS: dict[str, Callable[..., Monitor]] = {
    "auto": Auto,
    "least_error": LeastError,
    "nodal_solution": NodalSolution,
    "arc_length": ArcLength,
    "curvature": Curvature,
    "weight": Weight,
    "tensor": Tensor,
    "intersection": Intersection,
}


def build_monitor(
    document: object,
    domain: Domain | Blocks,
    find_samples: FindSamples,
    path: str = "monitor",
    *,
    cells: Cells = "quad",
) -> Monitor:
    """The monitor that ``document`` describes, bound to ``domain``; an :class:`Auto` where it has no ``kind``.

    ``cells`` are those of the file, on which a least-error monitor measures the error. Raises
    :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """

    def function(given: object, at: str) -> object:
        return build_field(given, domain, find_samples, at)

    monitor = _monitor(function, cells)(document, path)
    with within(path):
        return _on_blocks(monitor, domain) if isinstance(domain, Blocks) else monitor.on(domain)


def _on_blocks(monitor: Any, blocks: Blocks) -> Monitor:
    """The monitor bound to blocks, by the checks of their problem."""
    try:
        return BlockProblem(monitor=monitor, domain=blocks).monitor
    except InputError as error:
        if error.field == "monitor.purpose":
            error.field = "monitor.for"
        raise


def _monitor(function: Reader, cells: Cells, documents: OneOf = MONITORS) -> ByKind[Monitor]:
    """The reader of monitors whose functions ``function`` reads."""

    def reader(annotation: Any) -> Reader:
        mark = one_of(annotation)
        if get_origin(annotation) is Annotated:
            (annotation, *_) = get_args(annotation)
        if mark is not None and mark is not SOURCES:
            return several(_monitor(function, cells, mark))
        plain = [one for one in get_args(annotation) if one is not NoneType]
        if get_origin(annotation) in (Union, UnionType) and len(plain) < len(get_args(annotation)):
            return optional(reader(plain[0]))
        return function if mark is SOURCES else SETTINGS.get(annotation, as_given)

    def record(document: type[MonitorDocument]) -> Callable[[object, str], Monitor]:
        keys = {key_of(document, name): reader(kind) for name, kind in types_of(document).items() if name != "kind"}
        return Refusing(Record(_maker(document, cells), keys), document.REFUSED)

    return ByKind({kind: record(document) for kind, document in documents.documents.items()}, documents.default)


def _maker(document: type[MonitorDocument], cells: Cells) -> Callable[..., Monitor]:
    """What makes a monitor of the keys of a document: some are no names of the solver, and all metrics are smoothed."""
    names = {key_of(document, name): name for name in types_of(document)}
    make = MAKERS[kind_of(document)]
    make = partial(make, cells=cells) if "cells" in signature(make).parameters else make

    @wraps(MAKERS[kind_of(document)], updated=())
    def made(*, smoothing: float = 0.0, **settings: Any) -> Monitor:
        field = ""
        try:
            monitor = make(**{names[key]: value for key, value in settings.items()})
            field = "smoothing"
            return monitor if smoothing == 0.0 else Smoothed(monitor=monitor, radius=smoothing)
        except InputError as error:
            error.field = field or document.JSON_NAMES.get(error.field, error.field)
            raise

    return made
