"""Transmission conditions: the equations of a subdomain on an interface, with data from its neighbour.

Each of the paper's conditions is **one discrete functional** of a window. The receiver sets its own functional equal
to the value that its neighbour's window has at the same grid line, so at the fixed point both windows agree with the
single-domain solution to rounding. All functionals speak of an interface in xi; one in eta is the same for the turned
window. :class:`Optimized` is of another kind: see :mod:`equimesh.schwarz.optimized`.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, Literal, Protocol, TypeAlias

import numpy as np

from equimesh.equations.mesh_equations import HalfFlux, LocalMetric, NodalState, SeenGradient
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.numerics.types import Array, IntArray
from equimesh_schema.document import is_number

Derivatives: TypeAlias = tuple[tuple[IntArray, Array], ...]
Strength: TypeAlias = float | Literal["auto"]


@dataclass(frozen=True)
class Functional:
    """Values on a grid line, shape ``(k,)``, with derivatives as (unknowns, values) pairs that add up."""

    values: Array
    derivatives: Derivatives


class PairOfFunctionals(Protocol):
    """A pair of functionals of a window on a grid line ``i``, one for each coordinate.

    ``ghosts`` is the number of grid lines that a window needs beyond its interface to evaluate them. ``p`` comes
    with the sign of the interface: positive on the upper side of a subdomain (B1, B3 of the paper), negative on the
    lower one (B2, B4). Derivatives are exact, and the limit of the iteration is the single-domain mesh:
    :func:`equimesh.testing.check_transmission` checks both.
    """

    name: ClassVar[str]
    ghosts: ClassVar[int]

    def normal(self, window: NodalState, i: int, p: float) -> Functional:
        """The functional that closes the coordinate across the interface (x, for an interface in xi)."""
        ...

    def tangential(self, window: NodalState, i: int, p: float) -> Functional:
        """The functional that closes the coordinate along the interface (y, for an interface in xi)."""
        ...

    def strength(self, distance: float) -> float:
        """``p`` of an interface at ``distance`` (in xi or eta) from the physical side beyond it."""
        ...


@dataclass(frozen=True, kw_only=True)
class Classical:
    """Both coordinates as the neighbour has them (Haynes and Howse, equations (10) and (11))."""

    name: ClassVar[str] = "classical"
    ghosts: ClassVar[int] = 0

    def normal(self, window: NodalState, i: int, p: float) -> Functional:  # noqa: ARG002
        """x on the line."""
        return _value(window.x, window.numbers[0], i)

    def tangential(self, window: NodalState, i: int, p: float) -> Functional:  # noqa: ARG002
        """y on the line."""
        return _value(window.y, window.numbers[1], i)

    def strength(self, distance: float) -> float:  # noqa: ARG002
        """Zero: there is no parameter."""
        return 0.0


@dataclass(frozen=True, kw_only=True)
class _Robin:
    """What both Robin conditions have in common."""

    ghosts: ClassVar[int] = 1
    p: Strength = "auto"

    def __post_init__(self) -> None:
        _check_strength(self.p)

    def tangential(self, window: NodalState, i: int, p: float) -> Functional:
        """``y_xi + p y``."""
        return _robin(window.y, window.numbers[1], i, window.d_xi, p)

    def strength(self, distance: float) -> float:
        """The given ``p``, or the reciprocal of ``distance``."""
        return _strength(self.p, distance)


@dataclass(frozen=True, kw_only=True)
class LinearRobin(_Robin):
    """``x_xi +- p x`` and ``y_xi +- p y`` as the neighbour has them (Haynes and Howse, B1 and B2, equation (12)).

    ``p > 0``; ``"auto"`` takes the reciprocal distance to the physical side beyond the interface, exact for the
    leading part of the equations. Raises :class:`~equimesh.errors.InputError` for any other ``p``.
    """

    name: ClassVar[str] = "linear_robin"

    def normal(self, window: NodalState, i: int, p: float) -> Functional:
        """``x_xi + p x``."""
        return _robin(window.x, window.numbers[0], i, window.d_xi, p)


@dataclass(frozen=True, kw_only=True)
class NonlinearRobin(_Robin):
    """``S1 +- p x`` and ``y_xi +- p y`` as the neighbour has them (Haynes and Howse, B3 and B4, equation (13)).

    ``S1`` is the metric length of the xi-direction at the interface nodes. ``p`` as in :class:`LinearRobin`.
    """

    name: ClassVar[str] = "nonlinear_robin"

    def normal(self, window: NodalState, i: int, p: float) -> Functional:
        """``S1 + p x``."""
        length, value = _metric_length(window, i), _value(window.x, window.numbers[0], i)
        scaled = tuple((unknown, p * by) for unknown, by in value.derivatives)
        return Functional(length.values + p * value.values, (*length.derivatives, *scaled))


class LineData(StrEnum):
    """The data of an optimized interface about the lines beyond it.

    ``LINE_SUMS``: the metric length of the whole rest of every line. ``LOCAL``: the metric length of the first edge,
    which a neighbour has in classical Schwarz methods.
    """

    LINE_SUMS = "line_sums"
    LOCAL = "local"


@dataclass(frozen=True, kw_only=True)
class Optimized:
    """An interface that yields as the rest of every grid line would; see :mod:`equimesh.schwarz.optimized`.

    A Robin condition for the squared metric length across the interface, whose weights come from the metric and whose
    parameter is the number of edges beyond: the Dirichlet-to-Neumann map of the leading part of the equations. With
    ``data=LineData.LINE_SUMS`` the number of iterations does not depend on the number of subdomains.
    """

    name: ClassVar[str] = "optimized"
    ghosts: ClassVar[int] = 1
    data: LineData = LineData.LINE_SUMS

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", choice(LineData, self.data, "transmission.data"))


TransmissionCondition: TypeAlias = Classical | LinearRobin | NonlinearRobin | Optimized


def label(condition: TransmissionCondition) -> str:
    """The condition's name, with a remark for local data."""
    is_local = isinstance(condition, Optimized) and condition.data is LineData.LOCAL
    return f"{condition.name} (local data)" if is_local else condition.name


def _check_strength(p: Strength) -> None:
    if p != "auto" and not (is_number(p) and math.isfinite(p) and p > 0):
        raise InputError(f'p = {p!r}: the Robin parameter must be a positive number or "auto"', field="transmission.p")


def _strength(p: Strength, distance: float) -> float:
    return 1.0 / distance if p == "auto" else float(p)


def _value(q: Array, numbers: IntArray, i: int) -> Functional:
    return Functional(q[i], ((numbers[i], np.ones(q.shape[1])),))


def _robin(q: Array, numbers: IntArray, i: int, spacing: float, p: float) -> Functional:
    one = np.ones(q.shape[1])
    weight = 1.0 / (2 * spacing)
    return Functional(
        weight * (q[i + 1] - q[i - 1]) + p * q[i],
        ((numbers[i + 1], weight * one), (numbers[i - 1], -weight * one), (numbers[i], p * one)),
    )


def _metric_length(window: NodalState, i: int) -> Functional:
    """``S1`` at the nodes of line ``i``: centred in xi; centred in eta, one-sided of second order at the ends."""
    across = 1.0 / (2 * window.d_xi)
    nodes, weights = _derivative_along(window.x.shape[1], window.d_eta)

    def along_xi(q: Array) -> Array:
        return np.asarray(across * (q[i + 1] - q[i - 1]))

    def along_eta(q: Array) -> Array:
        return np.asarray(np.sum(weights * q[i, nodes], axis=0))

    w = window
    seen = SeenGradient(
        x_xi=along_xi(w.x),
        y_xi=along_xi(w.y),
        x_eta=along_eta(w.x),
        y_eta=along_eta(w.y),
        u_xi=along_xi(w.u),
        u_eta=along_eta(w.u),
    )
    g = seen.gradient
    flux = HalfFlux((seen.x_xi, seen.y_xi), LocalMetric(w.metric, (w.x[i], w.y[i]), g))
    length = np.sqrt(2 * flux.value)
    every = np.arange(w.x.shape[1])
    stencil = [(i + 1, every, across, 0.0), (i - 1, every, -across, 0.0)]
    stencil += [(i, nodes[s], 0.0, weights[s]) for s in range(3)]
    derivatives = []
    for column, row, in_xi, in_eta in stencil:
        own = np.where(row == every, 1.0, 0.0) if column == i else 0.0
        excess = (w.u_x[column, row] - g[0], w.u_y[column, row] - g[1])
        by_position = flux.by_node(in_xi, own, seen.of(in_xi, in_eta), excess)
        derivatives += [(w.numbers[axis][column, row], by_position[axis] / length) for axis in range(2)]
    return Functional(length, tuple(derivatives))


def _derivative_along(points: int, spacing: float) -> tuple[IntArray, Array]:
    """Nodes and weights, shape ``(3, points)``, of a second-order first derivative at every node of a line."""
    nodes = np.arange(points) + np.array([[-1], [0], [1]])
    weights = np.tile([[-0.5], [0.0], [0.5]], points)
    nodes[:, 0], weights[:, 0] = (0, 1, 2), (-1.5, 2.0, -0.5)
    nodes[:, -1], weights[:, -1] = (points - 3, points - 2, points - 1), (0.5, -2.0, 1.5)
    return nodes, weights / spacing
