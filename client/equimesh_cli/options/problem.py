"""The document of a mesh from options, as the client sends it, and the problem that the solver builds from it."""

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from equimesh import Blocks, Domain, Expression, ExpressionError, specs
from equimesh_cli.options.mesh import points_of, schwarz_of, target_of
from equimesh_cli.options.monitors import monitor_of
from equimesh_cli.parser import CommandError
from equimesh_client.errors import caret
from equimesh_client.spec.domains import domain_json
from equimesh_client.spec.request import MeshOptions, mesh_spec, monitor_json
from equimesh_schema.mesh import UNIT_SQUARE

FILES = (".csv", ".json", ".msh", ".npz", ".vtu")
"""Ends of names of files, which are no expressions."""


def document_of(options: argparse.Namespace) -> dict[str, Any]:
    """The JSON of the mesh; samples are named by their files."""

    def read(source: object) -> dict[str, Any]:
        return {"samples": str(source)} if isinstance(source, Path) else _expression(str(source), options)

    u = options.u if options.samples is None else options.samples
    if options.column is not None:
        u = Path(f"{options.samples}#{options.column}")
    mesh_options: MeshOptions = {
        "domain": options.domain,
        "schwarz": schwarz_of(options),
        "target": target_of(options),
        "boundary": options.boundary,
        "mode": options.mode,
        "allow_relaxed": not options.no_relax,
    }
    monitor = monitor_json(monitor_of(options), read, u)
    return mesh_spec(monitor, points_of(options), mesh_options, initial=options.initial, cells=options.cells)


def build(options: argparse.Namespace) -> specs.BuiltSpec:
    """The problem. A faulty expression raises :class:`CommandError`, with a caret under the fault."""
    document = document_of(options)
    with _carets(document):
        return specs.build(document, specs.samples_in(Path()), specs.meshes_in(Path()))


def build_expression(options: argparse.Namespace) -> tuple[Expression, Domain | Blocks]:
    """The expression U, checked on the domain, and the domain; raises as :func:`build`."""
    source, domain = _expression(options.u, options), domain_json(options.domain or UNIT_SQUARE)
    with _carets({**source, "domain": domain}):
        where = specs.build_domain(domain, specs.meshes_in(Path()))
        return specs.build_expression(source, where), where


def _expression(text: str, options: argparse.Namespace) -> dict[str, Any]:
    return {"expression": text, "parameters": dict(options.parameter), "t": options.t or 0.0}


@contextmanager
def _carets(document: Mapping[str, Any]) -> Iterator[None]:
    """Errors in an expression of ``document`` are raised as :class:`CommandError`, with a caret under the place."""
    try:
        yield
    except ExpressionError as error:
        text: Any = document
        for part in error.field.split("."):
            text = text.get(part) if isinstance(text, Mapping) else None
        place = error.position
        marked = "" if place is None else caret(text, line=place.line, column=place.column)
        if isinstance(text, str) and text.lower().endswith(FILES):
            advice = "give samples by --samples FILE, a domain by --domain-file FILE"
            raise CommandError(f"{text} is no expression: {advice}") from error
        which = f"{error.field}: " if error.field.startswith("domain.") else ""
        raise CommandError(f"{which}{error}\n{marked}".rstrip("\n")) from error
