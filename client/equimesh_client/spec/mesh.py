"""The spec of a mesh and its options."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Literal, TypedDict

from equimesh_client.errors import BadArgument
from equimesh_client.spec.domains import Domain, domain_json, has_own_points
from equimesh_client.spec.monitors import Json
from equimesh_client.spec.schwarz import BlockSchwarz, Schwarz
from equimesh_schema.monitors import AnyMonitor as Monitor

DEFAULT_POINTS = 64
"""Points a side of `generate`."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """A requested interpolation error of u, in place of a grid.

    ``norm`` is ``"l2"`` for the error of u, ``"h1"`` for that of its gradient. ``max_points`` limits the grid; None
    stands for the limit of the service.
    """

    error: float
    norm: Literal["l2", "h1"] = "l2"
    max_points: int | None = None

    def json(self) -> Json:
        """The JSON of the target."""
        return {"norm": self.norm, "error": self.error, "max_points": self.max_points}


class MeshOptions(TypedDict, total=False):
    """Options of a mesh, for `generate` and `sequences.start` of both clients. Each of them may be left out."""

    monitor: Monitor | Mapping[str, Any] | None
    """What the mesh minimises or equidistributes. Default: None, which is :class:`Auto` of u, or :class:`ArcLength` of
    u where ``a`` or ``b`` is given.
    """
    domain: Domain | Mapping[str, Any] | None
    """The domain of the mesh. Default: None, which is the unit square."""
    a: float | None
    """Strength of the arc length, from 0 to 1. Default: None, which is 0.7 where ``b`` is given. A larger one makes
    cells smaller where u is steep.
    """
    b: float | None
    """Damping of the arc length where u is steep, not negative. Default: None, which is 0.05 where ``a`` is given. A
    larger one makes cells more equal.
    """
    target: Target | Mapping[str, Any] | None
    """An interpolation error in place of ``n``. Default: None, which takes the grid of ``n``."""
    schwarz: Schwarz | BlockSchwarz | Mapping[str, Any] | None
    """How the domain is divided into subdomains; a :class:`BlockSchwarz` on blocks. Default: None, which solves on a
    single domain.
    """
    boundary: str
    """How points move along the sides: ``"trace"`` (default), ``"equidistributed_1d"`` or ``"orthogonal"``."""
    mode: str
    """``"discretization"`` (default) solves to the error of the grid, ``"tight"`` to rounding."""
    allow_relaxed: bool
    """Whether a weaker monitor is accepted where the requested equations have no valid solution. Default: True.
    ``mesh.relaxed`` then reports it. With False such a mesh fails.
    """
    parts: int | Literal["auto"] | None
    """How many parts of a cluster the mesh is computed in; ``"auto"`` for as many as fit its workers. Default: None,
    which takes parts only where the mesh is too large for one machine.
    """
    label: str | None
    """Free text for the list of meshes. Default: None."""
    parameters: Mapping[str, float] | None
    """Values of further names in all expressions. Default: None."""
    t: float | None
    """Value of the name t in all expressions. Default: None."""
    n_samples: int
    """Points a side at which a callable is evaluated. Default: 129. Raise it for a callable with fine detail."""


DEFAULTS: MeshOptions = {
    "monitor": None,
    "domain": None,
    "a": None,
    "b": None,
    "target": None,
    "schwarz": None,
    "boundary": "trace",
    "mode": "discretization",
    "allow_relaxed": True,
    "parts": None,
    "label": None,
    "parameters": None,
    "t": None,
    "n_samples": 129,
}
"""The default of every option."""


def complete_options(options: MeshOptions, method: Callable[..., object]) -> MeshOptions:
    """All options of a mesh: the arguments of ``method``, and the defaults of the others.

    Raises :class:`TypeError` for an option that the method does not have; the message names the nearest one.
    """
    unknown = [name for name in options if name not in DEFAULTS]
    if unknown:
        names = [*DEFAULTS, *(name for name in inspect.signature(method).parameters if name not in ("self", "options"))]
        nearest = get_close_matches(unknown[0], names, n=1)
        advice = f"did you mean {nearest[0]!r}?" if nearest else f"it has {', '.join(names)}"
        raise TypeError(f"{method.__name__}() has no option {unknown[0]!r}; {advice}")
    return {**DEFAULTS, **options}


def points_per_side(n: int | tuple[int, int]) -> tuple[int, int]:
    """``(n_xi, n_eta)`` of ``n``: one number for both directions, or a pair.

    Raises :class:`BadArgument` for anything else; the service checks the values.
    """
    pair = n if isinstance(n, tuple | list) else (n, n)
    try:
        n_xi, n_eta = pair
        if int(n_xi) == n_xi and int(n_eta) == n_eta:
            return int(n_xi), int(n_eta)
    except (TypeError, ValueError):
        pass
    raise BadArgument(f"n is the number of points a side, an integer or a pair (n_xi, n_eta), not {n!r}")


def _schwarz_json(schwarz: object) -> Json | None:
    """The JSON of the settings of a Schwarz iteration; raises :class:`BadArgument` for another object."""
    if schwarz is None or isinstance(schwarz, Schwarz | BlockSchwarz):
        return None if schwarz is None else schwarz.json()
    if isinstance(schwarz, Mapping):
        return dict(schwarz)
    raise BadArgument(
        "schwarz is a Schwarz, such as Schwarz(subdomains=(2, 1)), on blocks a BlockSchwarz(), or None for a single"
        f" domain; not {schwarz!r:.80}"
    )


def mesh_spec(
    monitor: Mapping[str, Any],
    n: int | tuple[int, int],
    options: MeshOptions = DEFAULTS,
    *,
    initial: str = "nested",
    cells: str = "quad",
) -> Json:
    """The JSON body of a request for a mesh; ``monitor`` is its JSON, which ``options`` do not replace.

    Keys unknown to services of the first release are left out where they have their default.
    """
    options = {**DEFAULTS, **options}
    n_xi, n_eta = points_per_side(n)
    target = options["target"]
    if target is not None and (n_xi, n_eta) != (DEFAULT_POINTS, DEFAULT_POINTS):
        raise BadArgument("a target takes the place of n: give one of them")
    if has_own_points(options["domain"]) and (n_xi, n_eta) != (DEFAULT_POINTS, DEFAULT_POINTS):
        raise BadArgument("the blocks of a domain have numbers of cells of their own: leave n out, and refine them")
    spec: Json = {
        "monitor": dict(monitor),
        "grid": {"n_xi": n_xi, "n_eta": n_eta},
        "boundary": str(options["boundary"]),
        "initial": str(initial),
        "schwarz": _schwarz_json(options["schwarz"]),
        "cells": str(cells),
    }
    if target is not None:
        spec["target"] = target.json() if isinstance(target, Target) else dict(target)
    if options["domain"] is not None:
        spec["domain"] = domain_json(options["domain"])
    if target is not None or has_own_points(options["domain"]):
        del spec["grid"]
    if options["mode"] != DEFAULTS["mode"]:
        spec["mode"] = str(options["mode"])
    if not options["allow_relaxed"]:
        spec["allow_relaxed"] = False
    if options["parts"] is not None:
        spec["parts"] = options["parts"]
    if options["label"] is not None:
        spec["label"] = options["label"]
    return spec
