"""The spec of a mesh, from the arguments of a call."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from equimesh_client.errors import BadArgument
from equimesh_client.spec.schwarz import Json, Schwarz

BOUNDARIES = ("trace", "equidistributed_1d", "orthogonal")


INITIALS = ("nested", "uniform")


CELLS = ("quad", "triangle")


MODES = ("discretization", "tight")


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


def mesh_spec(
    monitor: Mapping[str, Any],
    n: int | tuple[int, int],
    *,
    domain: Mapping[str, Any] | None = None,
    schwarz: Schwarz | Mapping[str, Any] | None = None,
    boundary: str = "trace",
    initial: str = "nested",
    mode: str = "discretization",
    allow_relaxed: bool = True,
    cells: str = "quad",
    label: str | None = None,
) -> Json:
    """The JSON body of a request for a mesh. ``schwarz=None`` asks for a single domain.

    What services of the first release do not know is left out where it is the default.
    """
    n_xi, n_eta = points_per_side(n)
    spec: Json = {
        "monitor": dict(monitor),
        "grid": {"n_xi": n_xi, "n_eta": n_eta},
        "boundary": str(boundary),
        "initial": str(initial),
        "schwarz": schwarz.json() if isinstance(schwarz, Schwarz) else (None if schwarz is None else dict(schwarz)),
        "cells": str(cells),
    }
    if domain is not None:
        spec["domain"] = dict(domain)
    if mode != "discretization":
        spec["mode"] = str(mode)
    if not allow_relaxed:
        spec["allow_relaxed"] = False
    if label is not None:
        spec["label"] = label
    return spec
