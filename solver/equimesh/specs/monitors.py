"""Monitors of a document."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any

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
from equimesh.specs.document import (
    ByKind,
    Reader,
    Record,
    Refusing,
    as_given,
    flag,
    number,
    optional,
    several,
    within,
)
from equimesh.specs.sources import FindSamples, build_field

USUAL_KIND = "auto"
"""The kind of a monitor that names none."""
USUAL_MEMBER = "arc_length"
"""The kind of a member of an intersection that names none: members need a metric."""
NO_SMOOTHING = (
    "smoothing averages a metric, and this monitor minimises the interpolation error itself: leave it out, or name a"
    " kind with a metric, such as curvature"
)
OF_ARC_LENGTH = "this belongs to the arc length, which is no longer the kind of a monitor that names none: add kind"
FOREIGN_TO_AUTO = {"smoothing": NO_SMOOTHING, **dict.fromkeys(("a", "b", "scaled"), f"{OF_ARC_LENGTH} arc_length")}
"""Keys of other kinds, with the sentence that refuses them where the kind is ``auto``."""


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


def _monitor(function: Reader, cells: Cells) -> ByKind[Monitor]:
    """The reader of monitors whose functions ``function`` reads."""
    angle = optional(number)
    plain = {
        "arc_length": _record(ArcLength, u=function, a=number, b=number, scaled=flag, orthogonality=angle),
        "curvature": _record(Curvature, u=function, norm=as_given, isotropic=flag, orthogonality=angle),
        "weight": _record(Weight, rho=function, u=optional(function), map=as_given, orthogonality=angle),
        "tensor": _record(Tensor, m11=function, m12=function, m22=function, u=optional(function), orthogonality=angle),
    }
    members = several(ByKind(plain, USUAL_MEMBER))
    both: dict[str, Reader] = {"u": function, "norm": as_given, "orthogonality": angle}
    auto = Record(_auto(cells), {**both, "for": as_given})
    weights = {"distortion": number, "smoothness": number, "rectilinear": flag}
    least_error = Record(partial(LeastError, cells=cells), {**both, **weights})
    solution = Record(NodalSolution, both)
    kinds: dict[str, Callable[[object, str], Monitor]] = {
        "auto": Refusing(auto, FOREIGN_TO_AUTO),
        "least_error": Refusing(least_error, {"smoothing": NO_SMOOTHING}),
        "nodal_solution": Refusing(solution, {"smoothing": NO_SMOOTHING}),
        **plain,
        "intersection": _record(Intersection, monitors=members, orthogonality=angle),
    }
    return ByKind(kinds, USUAL_KIND)


def _auto(cells: Cells) -> Callable[..., Auto]:
    """What makes a monitor of kind ``auto``: its key ``for`` is no name that Python allows."""

    @wraps(Auto, updated=())
    def make(**settings: Any) -> Auto:
        purpose = settings.pop("for", None)
        try:
            return Auto(cells=cells, purpose=purpose, **settings)
        except InputError as error:
            raise InputError(error.message, field="for" if error.field == "purpose" else error.field) from None

    return make


def _record(make: Callable[..., Monitor], **keys: Reader) -> Record[Monitor]:
    """The reader of a monitor with the ``keys``, and with ``smoothing``, which all monitors have."""

    @wraps(make, updated=())
    def smoothed(*, smoothing: float = 0.0, **settings: Any) -> Monitor:
        monitor = make(**settings)
        if smoothing == 0.0:
            return monitor
        try:
            return Smoothed(monitor=monitor, radius=smoothing)
        except InputError as error:
            raise InputError(error.message, field="smoothing") from None

    return Record(smoothed, {**keys, "smoothing": number})
