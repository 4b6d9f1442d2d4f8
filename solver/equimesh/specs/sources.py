"""Functions of x and y in a document: expressions, samples, and names of samples."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Box, Domain
from equimesh.errors import InputError, SamplesError
from equimesh.fields.chunked_samples import ChunkedSamples
from equimesh.fields.expression import Expression
from equimesh.fields.field import Field
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.io.sample_arrays import HDF5_SUFFIXES
from equimesh.specs.document import Makers, Reading, text, within
from equimesh.upload.samples import MAX_BYTES, NEEDS_BLOCKS, BlockNodes, block_nodes, nodal_samples, read_samples
from equimesh_schema import sources as schema

FindSamples: TypeAlias = Callable[[str, Box], Field]
"""The function whose samples have a name, on a box that they must cover."""
CHUNKED = (".zarr", *HDF5_SUFFIXES)
"""Suffixes of samples that are read part by part."""
ONE_KEY = (schema.GridSource, schema.NodalSource, schema.ScatteredSource, schema.BlockNodesSource)
"""Documents whose one key has the samples."""


def build_expression(document: object, domain: Domain | Blocks, path: str = "") -> Expression:
    """The expression of an object with the keys ``expression``, ``parameters`` and ``t``, finite on ``domain``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    reading = Reading({schema.ExpressionSource: _expression(domain)})
    expression: Expression = reading.record(schema.ExpressionSource, document, path)
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

    def on_blocks(*, nodes: object, values: object) -> Field:
        return _on(block_nodes(nodes=nodes, values=values), domain)

    makers: Makers = {
        schema.ExpressionSource: _expression(domain),
        schema.GridValues: partial(GridSamples, box=domain.box),
        schema.NodalValues: partial(nodal_samples, box=domain.box),
        schema.ScatteredValues: partial(ScatteredSamples, box=domain.box),
        schema.BlockNodes: on_blocks,
        schema.StoredSource: stored,
        **dict.fromkeys(ONE_KEY, lambda **made: next(iter(made.values()))),
    }
    field: Field = Reading(makers).one_of(schema.SOURCES, document, path)
    return field


def _on(field: Field, domain: Domain | Blocks) -> Field:
    """The function; values at the nodes of blocks need the cells of the domain."""
    if not isinstance(field, BlockNodes):
        return field
    if not isinstance(domain, Blocks):
        raise SamplesError(NEEDS_BLOCKS)
    return field.on(domain)


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
        return read_samples(data, file.name, column=column, box=box)

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
