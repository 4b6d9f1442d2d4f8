"""Monitors of a document."""

from collections.abc import Callable
from functools import partial
from inspect import signature
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
from equimesh.specs.document import Makers, Reading, within
from equimesh.specs.sources import FindSamples, build_field
from equimesh_schema import monitors as schema
from equimesh_schema.sources import SOURCES

MAKERS: Makers = {
    schema.Auto: Auto,
    schema.LeastError: LeastError,
    schema.NodalSolution: NodalSolution,
    schema.ArcLength: ArcLength,
    schema.ArcLengthMember: ArcLength,
    schema.Curvature: Curvature,
    schema.Weight: Weight,
    schema.Tensor: Tensor,
    schema.Intersection: Intersection,
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

    makers: Makers = {
        kind: _smoothed(partial(make, cells=cells) if "cells" in signature(make).parameters else make)
        for kind, make in MAKERS.items()
    }
    monitor = Reading(makers, {SOURCES: function}).one_of(schema.MONITORS, document, path)
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


def _smoothed(make: Callable[..., Monitor]) -> Callable[..., Monitor]:
    """What makes a monitor, and smooths its metric: all metrics can be smoothed."""

    def made(*, smoothing: float = 0.0, **settings: Any) -> Monitor:
        monitor = make(**settings)
        try:
            return monitor if smoothing == 0.0 else Smoothed(monitor=monitor, radius=smoothing)
        except InputError as error:
            error.field = "smoothing"
            raise

    return made
