"""The conformance kit of :class:`~equimesh.monitors.monitor.Monitor`."""

import pickle

import numpy as np

from equimesh.domains.domain import UNIT, UNIT_SQUARE, Domain
from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array
from equimesh.solving.solve import solve
from equimesh.testing.fields import points_in
from equimesh.testing.functions import check_function, place, require, require_finite

ENTRIES = ("m11", "m12", "m22")
BEYOND = 1e-5  # distance outside the reference square at which the metric must hold, too
STRENGTHS = (0.0, 0.5, 0.5 + 1e-4, 1.0)
CONTINUOUS = 0.01  # largest change of the logarithm of a metric for 1e-4 of the strength
EQUAL = 1e-9  # of the size of a metric


def check_monitor(monitor: Monitor, domain: Domain = UNIT_SQUARE) -> None:
    """Raise :class:`AssertionError` where ``monitor`` breaks a promise of :class:`~equimesh.monitors.monitor.Monitor`.

    The data of the monitor must be finite on ``domain``. Checked at random points of it, which are the same in every
    call: shapes, values point by point, a finite and positive definite metric inside and 1e-5 outside, binding,
    weakening, pickling and ``u``; and that the mesh of the monitor at strength 0 is uniform on the unit square.
    """
    bound = monitor.on(domain)
    points = domain.map(*points_in((UNIT, UNIT)))
    check_function(bound.metric, "metric(x, y)", ENTRIES, points)
    edge = (-BEYOND, 1.0 + BEYOND)
    s, t = points_in((UNIT, UNIT))
    rim = domain.map(np.where(s < 0.5, *edge), t)
    metric = bound.metric(*points)
    for where in (points, rim):
        _require_definite(bound, "metric(x, y)", where)
    require(hasattr(monitor, "u"), "u is missing: it must be a field, or None where there is none")
    require(
        bound.u is None or callable(getattr(bound.u, "evaluate", None)),
        f"u must be a field, with a method evaluate, or None; it is a {type(bound.u).__name__}",
    )
    _require_equal(bound.on(domain).metric(*points), metric, "on(domain) of a bound monitor changes the metric", points)
    _require_equal(_pickled(bound).metric(*points), metric, "the metric changes by pickling", points)
    _check_weakened(bound, domain, points)


def _pickled(monitor: Monitor) -> Monitor:
    try:
        copy: Monitor = pickle.loads(pickle.dumps(monitor))
    except Exception as error:  # any class may raise
        raise AssertionError(f"the bound monitor cannot be pickled: {error}") from error
    return copy


def _check_weakened(bound: Monitor, domain: Domain, points: tuple[Array, Array]) -> None:
    metrics = {}
    for strength in STRENGTHS:
        weaker = bound.weakened(strength)
        _require_definite(weaker, f"weakened({strength}).metric(x, y)", points)
        metrics[strength] = weaker.metric(*points)
    none, half, more, whole = metrics.values()
    _require_equal(whole, bound.metric(*points), "weakened(1) is not the monitor itself", points)
    constant = tuple(np.full_like(entry, entry[0]) for entry in none)
    _require_equal(none, constant, "the metric of weakened(0) is not constant", points)
    size = np.maximum(half[0], half[2])
    for entry, after, before in zip(ENTRIES, more, half, strict=True):
        jump = np.abs(after - before) / size
        worst = int(jump.argmax())
        require(
            bool(jump[worst] < CONTINUOUS),
            f"weakened(strength): {entry} jumps by {jump[worst]:.3g} of the metric at {place(points, worst)}, where the"
            " strength changes by 1e-4",
        )
    if domain == UNIT_SQUARE:
        grid = Grid(n_xi=9, n_eta=8)
        mesh, uniform = solve(Problem(monitor=bound.weakened(0.0), grid=grid)).mesh, Mesh.uniform(grid)
        moved = max(np.abs(mesh.x - uniform.x).max(), np.abs(mesh.y - uniform.y).max())
        require(moved < EQUAL, f"the mesh of weakened(0) is not uniform: nodes are {moved:.3g} away")


def _require_definite(monitor: Monitor, name: str, points: tuple[Array, Array]) -> None:
    metric = monitor.metric(*points)
    require_finite(metric, name, ENTRIES, points)
    m11, m12, m22 = metric
    least = 0.5 * (m11 + m22) - np.hypot(0.5 * (m11 - m22), m12)
    worst = int(least.argmin())
    require(
        bool(least[worst] > 0.0),
        f"{name} is not positive definite at (x, y) = {place(points, worst)}: its smallest eigenvalue is"
        f" {least[worst]:.3g}",
    )


def _require_equal(
    metric: tuple[Array, Array, Array], other: tuple[Array, ...], what: str, points: tuple[Array, Array]
) -> None:
    size = np.maximum(metric[0], metric[2])
    for entry, one, two in zip(ENTRIES, metric, other, strict=True):
        apart = np.abs(one - two) / size
        worst = int(apart.argmax())
        require(bool(apart[worst] <= EQUAL), f"{what}: {entry} differs by {apart[worst]:.3g} at {place(points, worst)}")
