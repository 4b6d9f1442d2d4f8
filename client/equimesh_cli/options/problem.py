"""The solver's problem that options describe: what the client would send, as the solver's own objects."""

from __future__ import annotations

import argparse
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING

import equimesh as em
from equimesh.upload.samples import read_samples
from equimesh_cli.exits import Refused
from equimesh_cli.options.mesh import schwarz_of
from equimesh_cli.options.monitors import monitor_of
from equimesh_client import AnnulusSector, ArcLength, Curvature, Quadrilateral, Tensor, Weight

if TYPE_CHECKING:
    from equimesh_client.spec.domains import Domain


def build_problem(options: argparse.Namespace, grid: em.Grid) -> em.Problem:
    """The problem; raises :class:`Refused` for an expression, with a caret under the fault, and what the solver
    raises.
    """
    domain = build_domain(options.domain)
    monitor = _monitor(options, domain)
    return em.Problem(monitor=monitor, grid=grid, boundary=em.Boundary(options.boundary), domain=domain)


def build_schwarz(options: argparse.Namespace) -> em.Schwarz | None:
    """The solver's own settings: the client's, object for object."""
    asked = schwarz_of(options)
    if asked is None:
        return None
    condition = getattr(em, type(asked.transmission).__name__)
    settings = {field.name: getattr(asked, field.name) for field in fields(asked)}
    return em.Schwarz(**{**settings, "transmission": condition(**asdict(asked.transmission))})


def pointed(error: em.ExpressionError, text: str) -> str:
    """What is wrong with an expression, with a caret under the place."""
    from equimesh_client.errors import caret

    place = error.position
    shown = caret(text, line=place.line, column=place.column) if place is not None else ""
    return f"{error}\n{shown}" if shown else str(error)


def _monitor(options: argparse.Namespace, domain: em.Domain) -> em.Monitor:
    def read(given: object) -> em.Field:
        return _field(given, options, domain)

    u = options.u if options.samples is None else options.samples
    monitor: em.Monitor
    match monitor_of(options):
        case Curvature() as asked:
            monitor = em.Curvature(u=read(u), norm=asked.norm, isotropic=asked.isotropic)
        case Weight() as asked:
            monitor = em.Weight(rho=read(asked.rho), u=None if u is None else read(u))
        case Tensor() as asked:
            entries = {name: read(getattr(asked, name)) for name in ("m11", "m12", "m22")}
            monitor = em.Tensor(**entries, u=None if u is None else read(u))
        case ArcLength() as asked:
            monitor = em.ArcLength(u=read(u), a=asked.a, b=asked.b)
        case asked:
            raise AssertionError(f"no option makes {asked}")
    return em.Smoothed(monitor=monitor, radius=asked.smoothing) if asked.smoothing else monitor


def _field(given: object, options: argparse.Namespace, domain: em.Domain) -> em.Field:
    if isinstance(given, Path):
        return read_samples(given.read_bytes(), given.name, box=domain.box)
    text = str(given)
    try:
        expression = em.Expression(text, parameters=dict(options.parameter), t=options.t or 0.0)
        expression.check_finite(domain=domain)
    except em.ExpressionError as error:
        raise Refused(pointed(error, text)) from error
    return expression


def build_domain(asked: Domain | None) -> em.Domain:
    """The domain as the solver has it, the unit square for None; raises what the solver raises."""
    if asked is None:
        return em.Rectangle()
    if isinstance(asked, Quadrilateral):
        sides = {name: _curve(getattr(asked, name), name) for name in ("bottom", "right", "top", "left")}
        return em.Quadrilateral(**sides)
    if isinstance(asked, AnnulusSector):
        return em.AnnulusSector(center=asked.center, radii=asked.radii, angles=asked.angles)
    return em.Rectangle(x=asked.x, y=asked.y)


def _curve(given: object, side: str) -> em.Curve:
    if not isinstance(given, tuple):
        return em.Curve.through(given, side=side)  # type: ignore[arg-type]
    x, y, parameters = given
    try:
        return em.Curve.of_expressions(x, y, parameters, side=side)
    except em.ExpressionError as error:
        text = y if error.field.endswith(".y") else x
        raise Refused(f"{error.field}: {pointed(error, text)}") from error
