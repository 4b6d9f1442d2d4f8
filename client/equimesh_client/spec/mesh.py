"""The spec of a mesh and its options."""

import inspect
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any, Literal, TypedDict

from equimesh_client.errors import BadArgument
from equimesh_client.spec.domains import Domain, Json, domain_json, has_own_points
from equimesh_schema.document import keys_of, without_usual
from equimesh_schema.mesh import Grid, MeshSpec, Target
from equimesh_schema.monitors import AnyMonitor as Monitor
from equimesh_schema.schwarz import BlockSchwarz, Condition, Schwarz

DEFAULT_POINTS = Grid.n_xi
"""Points a side of `generate`."""


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
    "boundary": MeshSpec.boundary,
    "mode": MeshSpec.mode,
    "allow_relaxed": MeshSpec.allow_relaxed,
    "parts": MeshSpec.parts,
    "label": MeshSpec.label,
    "parameters": None,
    "t": None,
    "n_samples": 129,
}
"""The default of every option."""
OF_SPEC = tuple(name for name in DEFAULTS if name in keys_of(MeshSpec))
"""The options that are keys of the spec."""


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
    if schwarz is None or isinstance(schwarz, Mapping):
        return None if schwarz is None else dict(schwarz)
    if not isinstance(schwarz, Schwarz | BlockSchwarz):
        raise BadArgument(
            "schwarz is a Schwarz, such as Schwarz(subdomains=(2, 1)), on blocks a BlockSchwarz(), or None for a single"
            f" domain; not {schwarz!r:.80}"
        )
    if isinstance(schwarz, Schwarz) and not isinstance(schwarz.transmission, Condition):
        raise BadArgument(
            f"transmission = {str(schwarz.transmission)[:40]!r}: give Optimized(), Classical(), LinearRobin() or"
            " NonlinearRobin()"
        )
    return schwarz.to_json()


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
    target, domain = options["target"], options["domain"]
    if target is not None and (n_xi, n_eta) != (DEFAULT_POINTS, DEFAULT_POINTS):
        raise BadArgument("a target takes the place of n: give one of them")
    if has_own_points(domain) and (n_xi, n_eta) != (DEFAULT_POINTS, DEFAULT_POINTS):
        raise BadArgument("the blocks of a domain have numbers of cells of their own: leave n out, and refine them")
    given: Json = {
        **{name: options[name] for name in OF_SPEC},  # type: ignore[literal-required]
        "monitor": dict(monitor),
        "grid": None if target is not None or has_own_points(domain) else {"n_xi": n_xi, "n_eta": n_eta},
        "target": target.to_json() if isinstance(target, Target) else target,
        "domain": MeshSpec.domain if domain is None else domain_json(domain),
        "schwarz": _schwarz_json(options["schwarz"]),
        "initial": str(initial),
        "cells": str(cells),
    }
    spec = without_usual(MeshSpec(**given))
    return {name: value for name, value in spec.items() if name != "grid" or value is not None}
