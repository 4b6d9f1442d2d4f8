"""The request for a mesh: Schwarz settings as dataclasses, and the JSON spec of the HTTP interface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from equimesh_client.errors import BadArgument

BOUNDARIES = ("trace", "equidistributed_1d", "orthogonal")
ORDERINGS = ("alternating", "parallel")
INITIALS = ("nested", "uniform")
CELLS = ("quad", "triangle")
MODES = ("discretization", "tight")
TRANSMISSIONS = ("classical", "linear_robin", "nonlinear_robin")

Json: TypeAlias = dict[str, Any]
Parameter: TypeAlias = float | Literal["auto"]


@dataclass(frozen=True)
class Classical:
    """Dirichlet values are exchanged at the interfaces. Needs no parameter and converges slowly."""

    def json(self) -> Json:
        """The condition as the HTTP interface writes it."""
        return {"kind": "classical"}


@dataclass(frozen=True)
class LinearRobin:
    """The linear Robin condition with parameter ``p`` > 0, or ``"auto"`` for the service's choice."""

    p: Parameter = "auto"

    def json(self) -> Json:
        """The condition as the HTTP interface writes it."""
        return {"kind": "linear_robin", "p": self.p}


@dataclass(frozen=True)
class NonlinearRobin:
    """The nonlinear Robin condition with parameter ``p`` > 0, or ``"auto"`` for the service's choice."""

    p: Parameter = "auto"

    def json(self) -> Json:
        """The condition as the HTTP interface writes it."""
        return {"kind": "nonlinear_robin", "p": self.p}


Transmission: TypeAlias = Classical | LinearRobin | NonlinearRobin


@dataclass(frozen=True, kw_only=True)
class Schwarz:
    """How the domain is divided and how the parts are brought to agree.

    ``subdomains`` counts them along xi and eta; ``overlap`` is in grid points, at least 2.
    ``tolerance=None`` runs exactly ``max_iterations``. ``compare_single_domain=True`` also solves without
    division and records the error of every iteration against that mesh.
    """

    subdomains: tuple[int, int] = (2, 1)
    overlap: int = 4
    transmission: Transmission = field(default_factory=LinearRobin)
    ordering: str = "alternating"
    tolerance: float | None = 1e-10
    max_iterations: int = 100
    compare_single_domain: bool = False

    def json(self) -> Json:
        """The settings as the HTTP interface writes them."""
        return {
            "subdomains": list(self.subdomains),
            "overlap": self.overlap,
            "transmission": self.transmission.json(),
            "ordering": self.ordering,
            "tolerance": self.tolerance,
            "max_iterations": self.max_iterations,
            "compare_single_domain": self.compare_single_domain,
        }


def transmission(kind: str, p: Parameter | None = None) -> Transmission:
    """The transmission condition named ``kind``, with ``p`` if it takes one (``"auto"`` by default).

    Raises :class:`BadArgument` for an unknown name, or a parameter for ``classical``.
    """
    if kind == "classical":
        if p not in (None, "auto"):
            raise BadArgument("classical transmission takes no parameter p")
        return Classical()
    conditions: dict[str, type[LinearRobin | NonlinearRobin]] = {
        "linear_robin": LinearRobin,
        "nonlinear_robin": NonlinearRobin,
    }
    if kind not in conditions:
        raise BadArgument(f"unknown transmission {kind!r}; there are {', '.join(TRANSMISSIONS)}")
    return conditions[kind]("auto" if p is None else p)


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
