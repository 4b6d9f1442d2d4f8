"""Functions of x and y in a document, and the monitors that are made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from inspect import signature
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Box, Domain
from equimesh.equations.problem import Problem
from equimesh.errors import InputError, SamplesError
from equimesh.fields.chunked_samples import ChunkedSamples
from equimesh.fields.expression import Expression, Field
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.io.sample_arrays import HDF5_SUFFIXES
from equimesh.io.write import Cells
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
from equimesh.monitors.metrics import ArcLength, Curvature
from equimesh.monitors.monitor import Monitor
from equimesh.monitors.smoothed import Smoothed
from equimesh.monitors.tensor import Intersection, Tensor, Weight
from equimesh.specs.document import Makers, Reading, text, within
from equimesh.upload.nodal import NEEDS_BLOCKS, OF_BLOCKS, BlockNodes, block_nodes, nodal_samples, with_cells
from equimesh.upload.samples import MAX_BYTES, read_samples
from equimesh_schema import monitors as monitors_schema
from equimesh_schema import sources as sources_schema
from equimesh_schema.sources import SOURCES

# Functions of x and y in a document: expressions, samples, and names of samples.

FindSamples: TypeAlias = Callable[[str, Box], Field]
"""The function whose samples have a name, on a box that they must cover."""
CHUNKED = (".zarr", *HDF5_SUFFIXES)
"""Suffixes of samples that are read part by part."""
NODAL_SOLUTION = monitors_schema.NodalSolution.kind
ONE_KEY = [made for made in sources_schema.SOURCES.documents.values() if issubclass(made, sources_schema.SamplesSource)]
"""Documents whose one key has the samples."""


def build_expression(document: object, domain: Domain | Blocks, path: str = "") -> Expression:
    """The expression of an object with the keys ``expression``, ``parameters`` and ``t``, finite on ``domain``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    reading = Reading({sources_schema.ExpressionSource: _expression(domain)})
    expression: Expression = reading.record(sources_schema.ExpressionSource, document, path)
    return expression


def build_field(document: object, domain: Domain | Blocks, find_samples: FindSamples, path: str = "") -> Field:
    """The function that ``document`` describes, which can be used on the whole of ``domain``; a text is an expression.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    if isinstance(document, str):
        try:
            return build_expression({"expression": document}, domain, path)
        except InputError as error:
            error.field = path
            raise

    def stored(samples: object) -> Field:
        name = text(samples, "samples")
        with within("samples"):
            return _on(find_samples(name, domain.box), domain)

    def on_blocks(**given: object) -> Field:
        return _on(block_nodes(**given), domain)

    makers: Makers = {
        sources_schema.ExpressionSource: _expression(domain),
        sources_schema.GridValues: partial(GridSamples, box=domain.box),
        sources_schema.NodalValues: partial(nodal_samples, box=domain.box),
        sources_schema.ScatteredValues: partial(ScatteredSamples, box=domain.box),
        sources_schema.BlockNodes: on_blocks,
        sources_schema.StoredSource: stored,
        **dict.fromkeys(ONE_KEY, lambda **made: next(iter(made.values()))),
    }
    field: Field = Reading(makers).one_of(sources_schema.SOURCES, document, path)
    return field


def _on(field: Field, domain: Domain | Blocks) -> Field:
    """The function; values at the nodes of blocks need the cells of the domain."""
    if not isinstance(field, BlockNodes):
        return field
    if not isinstance(domain, Blocks):
        raise SamplesError(NEEDS_BLOCKS)
    return field.on(domain)


def counted(blocks: Blocks, document: object, find_samples: FindSamples) -> Blocks:
    """The blocks with the cells of the mesh that values of a solver are on, where the monitor is of such values."""
    u = document.get("u") if isinstance(document, Mapping) and document.get("kind") == NODAL_SOLUTION else None
    if not isinstance(u, Mapping):
        return blocks
    given: Any = u.get("block_nodes")
    if isinstance(u.get("samples"), str):
        with within("monitor.u.samples"):
            given = find_samples(u["samples"], blocks.box)
        given = vars(given) if isinstance(given, BlockNodes) else None
    if not isinstance(given, Mapping) or given.get(OF_BLOCKS) is None or not hasattr(given.get("nodes"), "__len__"):
        return blocks
    with within("monitor.u" if "samples" in u else "monitor.u.block_nodes"):
        return with_cells(blocks, given[OF_BLOCKS], len(given["nodes"]))


def no_samples(name: str, box: Box) -> Field:  # noqa: ARG001 - a FindSamples
    """Raises :class:`~equimesh.errors.SamplesError`: there are no samples with names."""
    raise SamplesError(f"there are no samples named {name[:40]!r} here: give find_samples, or the samples themselves")


def samples_in(folder: Path) -> FindSamples:
    """Samples whose names are those of files, as :func:`~equimesh.upload.samples.read_samples` reads them.

    ``"flow.csv#T"`` is the file ``flow.csv`` with the column T as u. Those in a zarr folder, an HDF5 file or a long npy
    file are :class:`~equimesh.ChunkedSamples`, which stay there.

    What it returns raises :class:`~equimesh.errors.SamplesError` for a file that cannot be read.
    """

    def find(name: str, box: Box) -> Field:
        file, column = folder / name, None
        if "#" in name and not file.exists():
            whole, _, column = name.partition("#")
            file = folder / whole
        if file.suffix.lower() in CHUNKED or _is_long_npy(file):
            if column is not None:
                raise SamplesError(f"{file.name} has no columns: leave {column[:40]!r} out")
            return ChunkedSamples(path=file, box=box)
        try:
            data = file.read_bytes()
        except (OSError, ValueError) as error:
            raise SamplesError(f"{file}: {getattr(error, 'strerror', None) or error}") from error
        try:
            return read_samples(data, file.name, column=column, box=box)
        except SamplesError as error:
            named = error.message if file.name in error.message else f"{file.name}: {error.message}"
            raise SamplesError(named, field=error.field, columns=error.columns) from error

    return find


def _is_long_npy(file: Path) -> bool:
    """Whether a file is an npy that is too long to be read at once."""
    return file.suffix.lower() == ".npy" and file.is_file() and file.stat().st_size > MAX_BYTES


def _expression(domain: Domain | Blocks) -> Callable[..., Expression]:
    def make(expression: str, parameters: Mapping[str, float] = MappingProxyType({}), t: float = 0.0) -> Expression:
        made = Expression(expression, parameters=parameters, t=t)
        made.check_finite(domain=domain)
        return made

    return make


MAKERS: Makers = {
    monitors_schema.Auto: Auto,
    monitors_schema.LeastError: LeastError,
    monitors_schema.NodalSolution: NodalSolution,
    monitors_schema.ArcLength: ArcLength,
    monitors_schema.ArcLengthMember: ArcLength,
    monitors_schema.Curvature: Curvature,
    monitors_schema.Weight: Weight,
    monitors_schema.Tensor: Tensor,
    monitors_schema.Intersection: Intersection,
}

# The monitors that know the cells of the file.
_WITH_CELLS = frozenset(kind for kind, make in MAKERS.items() if "cells" in signature(make).parameters)


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
        kind: _smoothed(partial(make, cells=cells) if kind in _WITH_CELLS else make) for kind, make in MAKERS.items()
    }
    monitor = Reading(makers, {SOURCES: function}).one_of(monitors_schema.MONITORS, document, path)
    with within(path):
        return _on_blocks(monitor, domain) if isinstance(domain, Blocks) else monitor.on(domain)


def _on_blocks(monitor: Any, blocks: Blocks) -> Monitor:
    """The monitor bound to blocks, by the checks of their problem."""
    try:
        return Problem(monitor=monitor, domain=blocks).monitor
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
