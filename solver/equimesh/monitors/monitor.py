"""Monitor functions: the metric tensor that a mesh is to equidistribute, and the algebra of such tensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeAlias, TypeVar, runtime_checkable

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain
from equimesh.errors import InputError
from equimesh.fields.expression import Field
from equimesh.inputs import keep_floats
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array
from equimesh_schema.document import is_number

# Symmetric 2 x 2 matrices at many points, in closed form: power, intersection, eigenvalues.
#
# A matrix field is a triple ``(m11, m12, m22)`` of arrays of one shape; so is every result that is one. Nothing is
# checked and nothing is raised: where a matrix is not what the function needs, the result is nan or meaningless.

Matrices: TypeAlias = tuple[Array, Array, Array]

CORNER_WIDTH = 1e-4
"""Width of the rounded corner of the maximum in :func:`intersection`, squared, relative to the metrics."""


def eigenvalues(matrices: Matrices) -> tuple[Array, Array]:
    """The smaller and the larger eigenvalue."""
    m11, m12, m22 = matrices
    mean, radius = 0.5 * (m11 + m22), np.hypot(0.5 * (m11 - m22), m12)
    return mean - radius, mean + radius


def power(matrices: Matrices, exponent: float) -> Matrices:
    """The positive definite matrices to a real power: the same eigenvectors, the eigenvalues to that power."""
    return _each(_power, matrices, float(exponent))


def intersection(first: Matrices, second: Matrices) -> Matrices:
    """The metric of two by simultaneous reduction: ``v^T M v`` is at least that of either for every v.

    The intersection of metrics of P. J. Frey and F. Alauzet (Comput. Methods Appl. Mech. Engrg. 194, 2005). In the
    basis in which both are diagonal, with the first the identity and the second mu, it is
    ``max(1, mu)``, rounded upwards near mu = 1 (by half a percent at 1) so that it depends smoothly on both.
    It has the form ``c1 first + c2 second``: no eigenvectors are computed. The order does not matter.
    """
    out = np.empty((3, np.size(first[0])))
    _intersection(_flat(first), _flat(second), CORNER_WIDTH, out)
    return _split(out, np.shape(first[0]))


def _flat(matrices: Matrices) -> Matrices:
    m11, m12, m22 = (np.ascontiguousarray(entry, dtype=np.float64).reshape(-1) for entry in matrices)
    return m11, m12, m22


def _each(kernel: Callable[..., None], matrices: Matrices, number: float) -> Matrices:
    m11, m12, m22 = (np.asarray(entry, dtype=np.float64, order="C") for entry in matrices)
    out = np.empty((3, m11.size))
    kernel(m11.reshape(-1), m12.reshape(-1), m22.reshape(-1), number, out)
    return _split(out, m11.shape)


def _split(out: Array, shape: tuple[int, ...]) -> Matrices:
    return out[0].reshape(shape), out[1].reshape(shape), out[2].reshape(shape)


@compiled
def _power(m11: Array, m12: Array, m22: Array, exponent: float, out: Array) -> None:
    """With eigenvalues ``g exp(+-r)`` the power is ``g^p (cosh(p r) I + sinh(p r) / sinh(r) (M/g - cosh(r) I))``."""
    for i in range(m11.size):
        mean, half = 0.5 * (m11[i] + m22[i]), 0.5 * (m11[i] - m22[i])
        radius = np.sqrt(half * half + m12[i] * m12[i])
        root = np.sqrt(m11[i] * m22[i] - m12[i] * m12[i])
        stretch = (mean + radius) / root
        if stretch > 1.0 + 1e-8:
            one = stretch**exponent
            other = 1.0 / one
            ratio = (one - other) / (stretch - 1.0 / stretch)
        else:
            one = other = 1.0
            ratio = exponent
        if not root > 0.0:
            ratio = np.nan
        size = root**exponent
        centre, scale = size * 0.5 * (one + other), size * ratio / root
        out[0, i] = centre + scale * half
        out[1, i] = scale * m12[i]
        out[2, i] = centre - scale * half


@compiled
def _intersection(first: Matrices, second: Matrices, rounding: float, out: Array) -> None:
    """``c1 M + c2 N`` with ``c1 + c2 mu = (1 + mu + s(mu)) / 2``, ``s = sqrt((mu - 1)^2 + rounding mu)``.

    mu are the eigenvalues of ``M^-1 N``; only their sum t and product d are needed, and the two s come in as their
    product and their sum.
    """
    (m11, m12, m22), (n11, n12, n22) = first, second
    for i in range(m11.size):
        det = m11[i] * m22[i] - m12[i] * m12[i]
        t = (m22[i] * n11[i] - 2.0 * m12[i] * n12[i] + m11[i] * n22[i]) / det
        d = (n11[i] * n22[i] - n12[i] * n12[i]) / det
        gap = d - t + 1.0
        mixed = max((d + 1.0) * t - 4.0 * d, 0.0)
        product = np.sqrt(gap * gap + rounding * (mixed + rounding * d))
        total = np.sqrt(max((t - 1.0) ** 2 + 1.0 - 2.0 * d, 0.0) + rounding * t + 2.0 * product)
        c1 = 0.5 * (1.0 + (1.0 - d + product) / total)
        c2 = 0.5 * (1.0 + (t - 2.0 + rounding) / total)
        out[0, i] = c1 * m11[i] + c2 * n11[i]
        out[1, i] = c1 * m12[i] + c2 * n12[i]
        out[2, i] = c1 * m22[i] + c2 * n22[i]


MAX_ORTHOGONALITY = 90.0
"""The largest bound of the angle of non-orthogonality, in degrees: it bounds nothing."""


class Monitor(Protocol):
    """A symmetric positive definite tensor M(x, y) of the physical plane; a mesh equidistributes lengths in M.

    Monitors can be pickled: a bound one gives the same metric in another process.
    :func:`equimesh.testing.check_monitor` checks what is promised here.
    """

    @property
    def u(self) -> Field | None:
        """The function whose interpolation is measured and which mesh files carry, if there is one."""
        ...

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points of any shape; dimensionless, exact.

        The value at a point does not depend on the other points, and ``x`` and ``y`` are not written into. It is also
        evaluated slightly (1e-5 of its size) outside the domain. Values may be non-finite where the data are.
        """
        ...

    def on(self, domain: Domain) -> Monitor:
        """The monitor bound to ``domain``: checked there, with what depends on the whole domain computed.

        Binding a bound monitor again changes nothing. Raises :class:`~equimesh.errors.InputError` where it cannot be
        used on it.
        """
        ...

    def weakened(self, strength: float) -> Monitor:
        """A monitor that adapts less, for ``strength`` in [0, 1]: 0 adapts to nothing, 1 is the monitor itself.

        The metric for 0 is constant. It depends continuously on ``strength``. A bound monitor gives a bound one.
        """
        ...


def require_monitor(monitor: object) -> None:
    """Raise :class:`~equimesh.errors.InputError` for what is no monitor, such as a class or a text."""
    if isinstance(monitor, type) or not callable(getattr(monitor, "metric", None)):
        message = f"monitor = {str(monitor)[:40]!r} is no monitor: give one, such as Auto(u=...)"
        raise InputError(message, field="monitor")


@runtime_checkable
class OfDerivatives(Protocol):
    """A bound monitor whose metric at a point depends on u and its derivatives there, and on nothing else.

    Who needs both the metric and u evaluates u once, for both.
    """

    @property
    def order(self) -> int:
        """The order of the derivatives that the metric needs."""
        ...

    def metric_of(self, *derivatives: Array) -> tuple[Array, Array, Array]:
        """:meth:`Monitor.metric` at points where u and its derivatives up to :attr:`order` are these."""
        ...


def map_of(monitor: Monitor) -> str:
    """How cells get equal shares of the metric: ``"gradient"`` for a gradient map, otherwise ``"lines"``."""
    return str(getattr(monitor, "map", "lines"))


def orthogonality_of(monitor: Monitor) -> float | None:
    """The largest angle of non-orthogonality that a mesh may have, in degrees; ``None`` where there is no bound.

    Of a monitor that is made of others it is the smallest of all bounds.
    """
    inner = [monitor.monitor] if hasattr(monitor, "monitor") else getattr(monitor, "monitors", ())
    bounds = [getattr(monitor, "orthogonality", None), *(orthogonality_of(one) for one in inner)]
    return min((bound for bound in bounds if bound is not None), default=None)


def require_orthogonality(monitor: Any) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a bound that is neither ``None`` nor an angle in (0, 90]."""
    keep_floats(monitor, "orthogonality")
    angle = monitor.orthogonality
    if angle is None:
        return
    if not is_number(angle) or not 0.0 < angle <= MAX_ORTHOGONALITY:
        raise InputError(
            f"orthogonality = {angle!r}: the largest angle of non-orthogonality is one in degrees, over 0 and at most"
            f" {MAX_ORTHOGONALITY:g}; 50 suits most finite-volume codes",
            field="orthogonality",
        )


def require_lines(monitor: Monitor) -> None:
    """Raises :class:`~equimesh.errors.InputError` for a gradient map where subdomains are requested."""
    if map_of(monitor) != "lines":
        raise InputError(
            "a gradient map is not made of subdomains: leave out schwarz, or take map = 'lines'", field="schwarz"
        )


def require_strength(strength: float) -> float:
    """``strength`` if it lies in [0, 1]; otherwise raises :class:`~equimesh.errors.InputError`."""
    if not 0.0 <= strength <= 1.0:
        raise InputError(f"strength = {strength}: the strength of a monitor lies in [0, 1]", field="strength")
    return float(strength)


@dataclass(frozen=True, kw_only=True)
class OfMonitor:
    """A monitor that is made of another one, whose u and map it has."""

    monitor: Monitor

    @property
    def u(self) -> Field | None:
        """The u of the monitor."""
        return self.monitor.u

    @property
    def map(self) -> str:
        """The map of the monitor."""
        return map_of(self.monitor)


# A monitor that adapts less than another.


@dataclass(frozen=True, kw_only=True)
class Weakened(OfMonitor):
    """The metric of ``monitor`` to the matrix power ``strength`` in [0, 1]: 0 gives the identity.

    The directions stay, the ratio of the metric lengths of two vectors shrinks. A
    :class:`~equimesh.monitors.monitor.Monitor`.
    """

    strength: float

    def __post_init__(self) -> None:
        require_strength(self.strength)

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` of ``M**strength`` at physical points."""
        return power(self.monitor.metric(x, y), self.strength)

    def on(self, domain: Domain) -> Weakened:
        """The monitor bound to ``domain``, as weak as this one."""
        bound = self.monitor.on(domain)
        return self if bound is self.monitor else replace(self, monitor=bound)

    def weakened(self, strength: float) -> Weakened:
        """Weaker again: the strengths multiply."""
        return replace(self, strength=self.strength * require_strength(strength))


def weaken(monitor: Monitor, strength: float) -> Monitor:
    """``monitor`` with its metric to the power ``strength``; itself for 1."""
    return monitor if require_strength(strength) == 1.0 else Weakened(monitor=monitor, strength=float(strength))


# Points all over a domain, at which monitors are checked and integrated before a solve.

T = TypeVar("T", bound=Any)
AnyDomain: TypeAlias = Domain | Blocks
"""An image of the unit square, or a domain in blocks."""

# Points in a direction: enough to detect fronts as thin as a hundredth of the domain.
CELLS = 256
MAX_CELLS = CELLS**2
"""Cells of blocks in which a point lies, at most; of more cells every second is taken, or every third, and so on."""


MAX_SIZE, MIN_SIZE = 1e140, 1e-140
"""The largest and smallest size of u: squares of its errors are numbers between them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Probe:
    """Points ``x``, ``y`` of a domain, flat arrays, and ``shares``: the share of its area that each represents.

    The images of the centres of a fine uniform grid of the reference square; their number does not depend on the
    grid of the mesh. On a domain in blocks they are the centres of the cells of its initial mesh, or of some of them
    where these are many. ``diameter`` is the longer extent of the domain's box.
    """

    x: Array
    y: Array
    shares: Array
    diameter: float

    @classmethod
    def of(cls, domain: AnyDomain, cells: int = CELLS) -> Probe:
        """``cells`` by ``cells`` points of ``domain``; on a domain in blocks one a cell, of few enough of them."""
        diameter = max(high - low for low, high in domain.box)
        if isinstance(domain, Blocks):
            every = math.ceil(len(domain.mesh.cells) / MAX_CELLS)
            corners = domain.mesh.points[domain.mesh.cells[::every]]
            x, y = corners.mean(axis=1).T
            (a, b), (c, d) = (corners[:, 2] - corners[:, 0]).T, (corners[:, 3] - corners[:, 1]).T
            areas = a * d - b * c
            return cls(x=x, y=y, shares=areas / areas.sum(), diameter=diameter)
        middle = (np.arange(cells) + 0.5) / cells
        s, t = (axis.ravel() for axis in np.meshgrid(middle, middle, indexing="ij"))
        x, y = domain.map(s, t)
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        areas = x_s * y_t - x_t * y_s
        return cls(x=x, y=y, shares=areas / areas.sum(), diameter=diameter)

    @classmethod
    def of_closure(cls, domain: AnyDomain, cells: int = CELLS) -> Probe:
        """The images of the nodes, sides and corners included; ``shares`` are equal."""
        diameter = max(high - low for low, high in domain.box)
        if isinstance(domain, Blocks):
            x, y = domain.mesh.points.T
            return cls(x=x, y=y, shares=np.full(x.size, 1.0 / x.size), diameter=diameter)
        line = np.linspace(0.0, 1.0, cells + 1)
        s, t = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
        x, y = domain.map(s, t)
        return cls(x=x, y=y, shares=np.full(x.size, 1.0 / x.size), diameter=diameter)

    def place(self, index: int) -> str:
        """Point number ``index``, for a message."""
        return f"(x, y) = ({self.x[index]:.6g}, {self.y[index]:.6g})"

    def require_finite(self, values: Sequence[Array], what: str, *, field: str) -> None:
        """Raise :class:`~equimesh.errors.InputError` at the first point where one of ``values`` is not finite.

        ``what`` begins the sentence, verb included.
        """
        bad = ~np.isfinite(values[0])
        for value in values[1:]:
            bad |= ~np.isfinite(value)
        if bad.any():
            raise InputError(
                f"{what} not finite at {self.place(int(bad.argmax()))}: take a function that is smooth on the whole"
                " domain",
                field=field,
            )

    def require_size(self, u: Array) -> None:
        """Raise :class:`~equimesh.errors.InputError` for values of ``u`` whose squares are no numbers."""
        size = float(np.abs(u).max())
        if size > MAX_SIZE or 0.0 < size < MIN_SIZE:
            raise InputError(
                f"u has the size {size:.3g}: squares of its errors are no numbers; multiply u by a constant, which does"
                " not change the mesh",
                field="u",
            )


def is_bound_to(bound: AnyDomain | None, domain: AnyDomain) -> bool:
    """Whether a monitor bound to ``bound`` is bound to ``domain`` already."""
    return bound is domain or (bound is not None and type(bound) is type(domain) and bool(bound == domain))


def bound_copy(monitor: T, domain: AnyDomain, /, **found: object) -> T:
    """A copy of a frozen dataclass, bound to ``domain``, with further fields ``found`` there."""
    copy = replace(monitor)
    for name, value in {"_domain": domain, **found}.items():
        object.__setattr__(copy, name, value)
    return copy
