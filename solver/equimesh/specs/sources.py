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
from equimesh.specs.document import ByKey, Record, as_given, mapping, text, within
from equimesh.upload.nodal import NEEDS_BLOCKS, BlockNodes, block_nodes, nodal_samples
from equimesh.upload.samples import MAX_BYTES, read_samples

FindSamples: TypeAlias = Callable[[str, Box], Field]
"""The function whose samples have a name, on a box that they must cover."""
CHUNKED = (".zarr", *HDF5_SUFFIXES)
"""Suffixes of samples that are read part by part."""


def build_expression(document: object, domain: Domain | Blocks, path: str = "") -> Expression:
    """The expression of an object with the keys ``expression``, ``parameters`` and ``t``, finite on ``domain``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    return _expression(domain)(document, path)


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

    def samples(given: object, at: str) -> Field:
        name = text(given, at)
        with within(at):
            return _on(find_samples(name, domain.box), domain)

    def on_blocks(*, nodes: object, values: object) -> Field:
        return _on(block_nodes(nodes=nodes, values=values), domain)

    on_grid = Record(partial(GridSamples, box=domain.box), dict.fromkeys(("x", "y", "values"), as_given))
    scattered = Record(partial(ScatteredSamples, box=domain.box), dict.fromkeys(("points", "values"), as_given))
    at_nodes = Record(partial(nodal_samples, box=domain.box), dict.fromkeys(("x", "y", "values"), as_given))
    in_blocks = Record(on_blocks, dict.fromkeys(("nodes", "values"), as_given))
    source: ByKey[Field] = ByKey(
        {
            "expression": _expression(domain),
            "grid": Record(lambda grid: grid, {"grid": on_grid}),
            "nodal": Record(lambda nodal: nodal, {"nodal": at_nodes}),
            "scattered": Record(lambda scattered: scattered, {"scattered": scattered}),
            "block_nodes": Record(lambda block_nodes: block_nodes, {"block_nodes": in_blocks}),
            "samples": Record(lambda samples: samples, {"samples": samples}),
        }
    )
    return source(document, path)


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


def _expression(domain: Domain | Blocks) -> Record[Expression]:
    def make(expression: str, parameters: Mapping[str, float] = MappingProxyType({}), t: float = 0.0) -> Expression:
        made = Expression(expression, parameters=parameters, t=t)
        made.check_finite(domain=domain)
        return made

    return Record(make, {"expression": as_given, "parameters": mapping, "t": as_given})
