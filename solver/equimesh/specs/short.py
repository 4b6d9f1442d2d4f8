"""One short call from a function to its mesh, for people at a prompt or in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from difflib import get_close_matches
from numbers import Integral
from typing import Any, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import UNIT_SQUARE, Domain
from equimesh.equations.problem import Problem, require_domain
from equimesh.errors import InputError
from equimesh.fields.expression import Expression, Field
from equimesh.meshes.mesh import Grid
from equimesh.monitors.monitor import Monitor, Probe
from equimesh.numerics.types import Array
from equimesh.schwarz.settings import Schwarz
from equimesh.solving.solution import AnySolution
from equimesh.solving.solve import solve
from equimesh.solving.target import Target
from equimesh.specs.monitors import MAKERS, build_field, no_samples
from equimesh_coupling import progress_bar
from equimesh_coupling.errors import BadValues
from equimesh_coupling.progress_bar import ProgressBar
from equimesh_coupling.samples import kind_of, pieces_of
from equimesh_schema.monitors import MONITORS

Function: TypeAlias = str | Field | npt.ArrayLike | Callable[[Array, Array], npt.ArrayLike] | Mapping[str, Any]
"""A function of x and y: a formula, a field, samples, or what takes arrays x and y."""
KINDS: Mapping[str, Callable[..., Monitor]] = {
    kind: MAKERS[document]
    for kind, document in MONITORS.documents.items()
    if document in MAKERS and kind not in ("weight", "tensor", "intersection", "nodal_solution")
}
"""The monitors of one function u, by their kinds."""
TARGETS = ("points", "max_points", "error", "target")
"""What belongs to a target, and is given to :func:`mesh` by people who know the rounds or the command line."""
PROBED_CELLS = 32
"""Cells a side of the grid at whose nodes a formula needs values."""


def mesh(
    u: Function,
    grid: int | tuple[int, int] | Grid | None = None,
    domain: Domain | Blocks = UNIT_SQUARE,
    *,
    monitor: str = "auto",
    schwarz: Schwarz | None = None,
    progress: bool | None = None,
    **settings: Any,
) -> AnySolution:
    """The mesh for ``u``, and all that is known about it: its errors, its certificate, its picture.

    ``u`` is a formula in x and y; a field, such as :class:`equimesh.Expression`; a function that takes arrays x and y;
    an array of values on the uniform grid of the domain, first index along x; or samples ``(x, y, values)`` or
    ``(points, values)``, as :func:`equimesh_coupling.samples.pieces_of` takes them. A function is called once, on
    129 x 129 points of the box of the domain: sample it on more points where it has finer features.

    ``grid`` is the number of points a side, 33 if it is not given, or ``(n_xi, n_eta)``; a domain in blocks has its
    own. ``monitor`` is ``"auto"``, ``"least_error"``, ``"arc_length"`` or ``"curvature"``, and ``settings`` are those
    of :class:`equimesh.Auto` and so on. ``parameters`` and ``t`` belong to a formula. A solve that takes longer than
    half a second shows its ``progress`` in a notebook and on a terminal; True shows it anywhere, False nowhere.

    Raises :class:`equimesh.InputError` for what cannot be used, and :class:`equimesh.SolveError` as
    :func:`equimesh.solve` does.
    """
    make = KINDS.get(monitor) if isinstance(monitor, str) else None
    if make is None:
        rest = "; solve(Problem(monitor=...)) takes monitors as objects"
        if isinstance(monitor, str):
            near = get_close_matches(monitor, KINDS, n=1)
            rest = f"; perhaps {near[0]} is meant" if near else ""
        raise InputError(f"monitor = {monitor!r:.40}: choose one of {', '.join(KINDS)}{rest}", field="monitor")
    formula = {name: settings.pop(name) for name in ("parameters", "t") if name in settings}
    _require_known(make, monitor, settings)
    require_domain(domain)
    function = field_of(u, domain, **formula)
    problem: Problem[Any]
    if isinstance(domain, Blocks):
        if grid is not None:
            raise InputError("a domain in blocks has its own numbers of points: leave the grid out", field="grid")
        problem = Problem(monitor=make(u=function, **settings), domain=domain)
    else:
        problem = Problem(monitor=make(u=function, **settings), grid=grid_of(grid), domain=domain)
    with ProgressBar(progress, delay=progress_bar.DELAY) as bar:
        return solve(problem, schwarz, observe=bar if bar.shown else None)


def field_of(
    u: Function, domain: Domain | Blocks = UNIT_SQUARE, *, parameters: Mapping[str, float] | None = None, t: float = 0.0
) -> Field:
    """The field that ``u`` stands for; see :func:`mesh`. ``parameters`` and ``t`` belong to a formula.

    Raises :class:`equimesh.InputError`, or its kin for faults in formulas and samples.
    """
    if isinstance(u, str):
        formula = Expression(u, parameters=parameters or {}, t=t)
        _require_values(formula, domain)
        return formula
    if parameters or t != 0.0:
        raise InputError("parameters and t belong to a formula: u is not a text here", field="parameters")
    if callable(getattr(u, "evaluate", None)) and not isinstance(u, type):
        return cast("Field", u)
    try:
        pieces = pieces_of(u, domain.box)
    except BadValues as error:
        raise InputError(str(error), field="u") from error.__cause__
    return build_field({kind_of(pieces): pieces}, domain, no_samples, "u")


def _require_values(formula: Expression, domain: Domain | Blocks) -> None:
    """Refuse a formula that is infinite or not defined somewhere; its slope may be infinite, as that of sqrt(x)."""
    points = Probe.of_closure(domain, PROBED_CELLS)
    if not np.isfinite(formula.evaluate(points.x, points.y)[0]).all():
        formula.check_finite(PROBED_CELLS + 1, domain)


def grid_of(given: int | tuple[int, int] | Grid | None) -> Grid:
    """The grid of one number of points a side, of two, or the usual one."""
    if isinstance(given, Grid):
        return given
    if isinstance(given, Target):
        raise InputError("grid is a Target: solve_to(Target(...), monitor=Auto(u)) finds the grid of one", field="grid")
    numbers: Any = (33,) if given is None else given if isinstance(given, tuple | list) else (given,)
    if not (1 <= len(numbers) <= 2 and all(isinstance(number, Integral) for number in numbers)):
        raise InputError(f"grid = {given!r:.40}: give a number of points a side, such as 33, or (33, 17)", field="grid")
    return Grid(*map(int, numbers))


def _require_known(make: Callable[..., Monitor], kind: str, settings: Mapping[str, Any]) -> None:
    """Refuse a setting that the monitor does not have."""
    known = [one.name for one in fields(make) if one.init and one.name != "u"]  # type: ignore[arg-type]
    for name in settings:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            perhaps = f"; perhaps {near[0]} is meant" if near else ""
            others = [other for other, maker in KINDS.items() if name in {one.name for one in fields(maker)}]  # type: ignore[arg-type]
            elsewhere = f"; {' and '.join(others)} have it" if others else ""
            if name in TARGETS:
                elsewhere = "; solve_to(Target(error=..., max_points=...), monitor=Auto(u)) finds a grid"
            raise InputError(
                f"the monitor {kind} has no setting {name!r}{perhaps}{elsewhere}; it has {', '.join(known)}", field=name
            )
