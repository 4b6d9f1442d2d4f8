"""Monitors of a document."""

from collections.abc import Callable
from functools import wraps
from typing import Any

from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.monitors.arc_length import ArcLength
from equimesh.monitors.curvature import Curvature
from equimesh.monitors.intersection import Intersection
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed
from equimesh.monitors.tensor import Tensor, Weight
from equimesh.specs.document import ByKind, Reader, Record, as_given, flag, number, optional, several, within
from equimesh.specs.sources import FindSamples, build_field

USUAL_KIND = "arc_length"


def build_monitor(document: object, domain: Domain, find_samples: FindSamples, path: str = "monitor") -> Monitor:
    """The monitor that ``document`` describes, bound to ``domain``; an arc length where it has no ``kind``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """

    def function(given: object, at: str) -> object:
        return build_field(given, domain, find_samples, at)

    monitor = _monitor(function)(document, path)
    with within(path):
        return monitor.on(domain)


def _monitor(function: Reader) -> ByKind[Monitor]:
    """The reader of monitors whose functions ``function`` reads."""
    plain = {
        "arc_length": _record(ArcLength, u=function, a=number, b=number, scaled=flag),
        "curvature": _record(Curvature, u=function, norm=as_given, isotropic=flag),
        "weight": _record(Weight, rho=function, u=optional(function), map=as_given),
        "tensor": _record(Tensor, m11=function, m12=function, m22=function, u=optional(function)),
    }
    members = several(ByKind(plain, USUAL_KIND))
    return ByKind({**plain, "intersection": _record(Intersection, monitors=members)}, USUAL_KIND)


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
