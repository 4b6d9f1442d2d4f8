"""Conformance kits: what every field, monitor, domain and transmission condition must hold."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np

from equimesh.domains.domain import UNIT, UNIT_SQUARE, Box, Domain
from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.expression import Expression, Field
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.monitors.metrics import ArcLength
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array
from equimesh.schwarz.conditions import Optimized, TransmissionCondition
from equimesh.schwarz.decomposition import Ordering
from equimesh.schwarz.iteration import schwarz_iterations, subdomains_of
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.settings import LocalSolver, Schwarz
from equimesh.single_domain.level import Mode
from equimesh.solving.solve import solve
from equimesh.testing.functions import STEP, check_derivative, check_function, place, require, require_finite, wrong_by

# The conformance kit of :class:`~equimesh.fields.expression.Field`.

DERIVATIVES = ("u", "u_x", "u_y", "u_xx", "u_xy", "u_yy")
COUNTS = (1, 3, 6)  # the number of them for each order
POINTS = 200


def check_field(field: Field, box: Box = (UNIT, UNIT)) -> None:
    """Raise :class:`AssertionError` if ``field`` breaks a promise of :class:`~equimesh.Field` in a box.

    The data of the field must be finite in ``box``, which is ``((x0, x1), (y0, y1))``. Checked at random points, which
    are the same in every call: shapes for all three orders, values point by point, arguments that are left alone, and
    each derivative by the Taylor remainder of the one before it.
    """
    size = min(high - low for low, high in box)
    points = points_in(box, margin=STEP * size)
    for order, count in enumerate(COUNTS):
        names, name = DERIVATIVES[:count], f"evaluate(x, y, order={order})"

        def derivatives(x: Array, y: Array, order: int = order) -> tuple[Array, ...]:
            return field.evaluate(x, y, order=order)

        check_function(derivatives, name, names, points)
        require_finite(derivatives(*corners(box)), name, names, corners(box))
        require_finite(derivatives(*points), name, names, points)

    def value(x: Array, y: Array) -> Array:
        return field.evaluate(x, y)[0]

    def u_x(x: Array, y: Array) -> Array:
        return field.evaluate(x, y, order=1)[1]

    def u_y(x: Array, y: Array) -> Array:
        return field.evaluate(x, y, order=1)[2]

    _, *first = field.evaluate(*points, order=1)
    _, again_x, again_y, xx, xy, yy = field.evaluate(*points, order=2)
    check_derivative(value, (first[0], first[1]), ("u_x of order 1", "u_y of order 1"), points, size)
    check_derivative(value, (again_x, again_y), ("u_x of order 2", "u_y of order 2"), points, size)
    check_derivative(u_x, (xx, xy), ("u_xx", "u_xy"), points, size)
    check_derivative(u_y, (xy, yy), ("u_xy", "u_yy"), points, size)


def points_in(box: Box, margin: float = 0.0) -> tuple[Array, Array]:
    """Random points of a box, ``margin`` away from its sides; always the same ones."""
    random = np.random.default_rng(20)
    x, y = (random.uniform(low + margin, high - margin, POINTS) for low, high in box)
    return x, y


def corners(box: Box) -> tuple[Array, Array]:
    """The four corners of a box."""
    (x0, x1), (y0, y1) = box
    return np.array([x0, x1, x1, x0]), np.array([y0, y0, y1, y1])


# The conformance kit of :class:`~equimesh.monitors.monitor.Monitor`.

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


# The conformance kit of :class:`~equimesh.domains.domain.Domain`.

SLOPES = ("x_s", "x_t", "y_s", "y_t")
UNIT_BOX = (UNIT, UNIT)
LINE = 257  # points a direction, or on a side
PANELS = 64  # a direction, of the integral of the determinant
AREA_ACCURACY = 1e-5  # relative
BOX_ACCURACY = 1e-4  # of the size: no point of the sides comes nearer to the smallest box than this


def check_domain(domain: Domain) -> None:
    """Raise :class:`AssertionError` where ``domain`` breaks a promise of :class:`~equimesh.domains.domain.Domain`.

    Checked: shapes and broadcasting, finite values up to 1e-5 outside the unit square, the Jacobian by Taylor
    remainders, its positive determinant up to the sides, the area as the integral of the determinant, and the box as
    the smallest one that holds the image.
    """
    points = points_in(UNIT_BOX, margin=0.0)
    check_function(domain.map, "map(s, t)", ("x", "y"), points)
    check_function(domain.jacobian, "jacobian(s, t)", SLOPES, points)
    _check_broadcast(domain)
    outside = corners(((-BEYOND, 1.0 + BEYOND), (-BEYOND, 1.0 + BEYOND)))
    for where in (points, outside):
        require_finite(domain.map(*where), "map(s, t)", ("x", "y"), where)
        require_finite(domain.jacobian(*where), "jacobian(s, t)", SLOPES, where)
    x_s, x_t, y_s, y_t = domain.jacobian(*points)
    check_derivative(lambda s, t: domain.map(s, t)[0], (x_s, x_t), ("x_s", "x_t"), points, 1.0)
    check_derivative(lambda s, t: domain.map(s, t)[1], (y_s, y_t), ("y_s", "y_t"), points, 1.0)
    _check_determinant(domain)
    _check_area(domain)
    _check_box(domain)


def _check_broadcast(domain: Domain) -> None:
    s, t = np.linspace(0.0, 1.0, 3)[:, None], np.linspace(0.0, 1.0, 4)[None, :]
    for name, results in (("map(s, t)", domain.map(s, t)), ("jacobian(s, t)", domain.jacobian(s, t))):
        found = {np.shape(result) for result in results}
        require(found == {(3, 4)}, f"{name} of shapes (3, 1) and (1, 4) has shapes {sorted(found)}, not (3, 4)")


def _check_determinant(domain: Domain) -> None:
    line = np.linspace(0.0, 1.0, LINE)
    points = np.repeat(line, LINE), np.tile(line, LINE)
    determinant = _determinant(domain, *points)
    worst = int(determinant.argmin())
    require(
        bool(determinant[worst] > 0.0),
        f"jacobian(s, t): the determinant is {determinant[worst]:.3g} at (s, t) = {place(points, worst)}, and must be"
        " positive",
    )


def _check_area(domain: Domain) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(3)
    line = ((np.arange(PANELS)[:, None] + 0.5 + 0.5 * nodes) / PANELS).ravel()
    share = np.tile(0.5 * weights / PANELS, PANELS)
    exact = float(share @ _determinant(domain, line[:, None], line[None, :]) @ share)
    require(
        abs(domain.area - exact) <= AREA_ACCURACY * exact,
        f"area = {domain.area:.9g}, but the integral of the determinant of jacobian(s, t) is {exact:.9g}",
    )


def _check_box(domain: Domain) -> None:
    line = np.linspace(0.0, 1.0, LINE * 4)
    zero, one = np.zeros_like(line), np.ones_like(line)
    sides = np.concatenate([line, line, zero, one]), np.concatenate([zero, one, line, line])
    for name, coordinate, (low, high) in zip("xy", domain.map(*sides), domain.box, strict=True):
        size = high - low
        for end, wanted, found in (("least", low, coordinate.min()), ("largest", high, coordinate.max())):
            outwards = (wanted - found if end == "least" else found - wanted) / size
            require(
                -BOX_ACCURACY <= outwards <= 1e-9,
                f"box: the {end} {name} of the domain is {found:.9g}, not {wanted:.9g}",
            )


def _determinant(domain: Domain, s: Array, t: Array) -> Array:
    x_s, x_t, y_s, y_t = domain.jacobian(s, t)
    return x_s * y_t - x_t * y_s


PROBLEM = Problem(monitor=ArcLength(u=Expression("tanh(2*(x + y/2 - 0.75))")), grid=Grid(n_xi=16, n_eta=15))
# Subdomains along xi and eta, their overlap, and the ordering.
CASES = (
    ((2, 1), 4, Ordering.PARALLEL),
    ((1, 2), 3, Ordering.ALTERNATING),
    ((3, 1), 5, Ordering.SYMMETRIC),
    ((2, 2), 4, Ordering.PARALLEL),
    ((2, 2), 3, Ordering.COLOURED),
)
LIMIT = 1e-9  # distance of the limit to the single-domain mesh
FIXED = 1e-9  # residual of a subdomain's equations at the single-domain mesh
MAX_ITERATIONS = 200
AWAY = 0.02  # largest move of the nodes away from the solution, where the iteration starts
MOVE = 0.01  # of the nodes, away from the solution, where derivatives are checked


def check_transmission(condition: TransmissionCondition) -> None:
    """Raise :class:`AssertionError` where a transmission condition breaks a promise of its port.

    On a small problem, for strips and blocks with several overlaps: subdomains that receive the data of the
    single-domain mesh keep it; the derivatives of the functionals, as rows of the subdomains' equations, are exact by
    Taylor remainders; and for every ordering the iteration converges to the single-domain mesh within 1e-9, without
    another condition that takes over.
    """
    require(
        isinstance(getattr(condition, "name", None), str) and isinstance(getattr(condition, "ghosts", None), int),
        "name must be a string, and ghosts the number of grid lines that are read beyond an interface",
    )
    _check_strength(condition)
    exact = solve(PROBLEM, mode=Mode.TIGHT).reference
    for counts, overlap, ordering in CASES:
        try:
            settings = Schwarz(
                subdomains=counts,
                overlap=overlap,
                transmission=condition,
                ordering=ordering,
                fallback=False,
                tolerance=LIMIT / 10.0,
            )
        except InputError as error:
            raise AssertionError(f"Schwarz does not take the condition: {error}") from error
        _check_equations(settings, exact)
        _check_limit(settings, exact)


def _check_strength(condition: TransmissionCondition) -> None:
    if isinstance(condition, Optimized):
        return
    for distance in (0.1, 0.5):
        p = condition.strength(distance)
        require(math.isfinite(p) and p >= 0.0, f"strength({distance}) = {p}: it must be finite and not negative")


def _check_equations(settings: Schwarz, exact: Mesh) -> None:
    """The single-domain mesh solves the equations of every subdomain, and their Jacobian is right nearby."""
    case = _describe(settings)
    decomposition, exactly = settings.decompose(PROBLEM.grid), replace(settings, local_solver=LocalSolver.NEWTON)
    subdomains = subdomains_of(PROBLEM, MergedMeshes(decomposition), exactly, enough=0.0, threads=1)
    subdomains.restart(exact)
    subdomains.begin(exact)
    random = np.random.default_rng(11)
    for k, window in enumerate(subdomains.windows):
        equations = subdomains.equations(k)
        z = equations.vector(window.restrict(exact))
        residual = np.abs(equations.residual(z))
        require(
            bool(residual.max() <= FIXED),
            f"{case}, subdomain {k} does not keep the single-domain mesh: with its data the equation of"
            f" {_unknown(int(residual.argmax()), window.shape)} has the residual {residual.max():.3g}",
        )
        moves = random.uniform(-1.0, 1.0, (2, z.size)) * ((z > 0.0) & (z < 1.0))  # nodes on a side stay on it
        z, along = z + MOVE * moves[0], moves[1]

        def moved(h: float, equations: MeshEquations = equations, z: Array = z, along: Array = along) -> Array:
            return equations.residual(z + h * along)

        wrong = wrong_by(moved, equations.jacobian(z) @ along)
        worst = int(wrong.argmax())
        require(
            wrong[worst] == 0.0,
            f"{case}, the derivative of the equation of {_unknown(worst, window.shape)} in subdomain {k} is wrong by"
            f" {wrong[worst]:.3g}: the Taylor remainder does not fall at second order",
        )


def _check_limit(settings: Schwarz, exact: Mesh) -> None:
    case, bump = _describe(settings), AWAY * np.sin(np.pi * exact.x) * np.sin(np.pi * exact.y)
    for record in schwarz_iterations(PROBLEM, settings, Mesh(exact.x + bump, exact.y - bump)):
        helped = [subdomain.subdomain for subdomain in record.subdomains if subdomain.classical]
        require(not helped, f"{case}, classical data took the place of the condition in subdomain {helped[:1]}")
        require(
            record.iteration < MAX_ITERATIONS and not record.failed,
            f"{case}, the iteration does not converge: after {record.iteration} iterations the mesh still moves by"
            f" {record.change:.3g}",
        )
        if record.meets(LIMIT / 10.0):
            break
    apart = max(np.abs(record.reference.x - exact.x).max(), np.abs(record.reference.y - exact.y).max())
    require(apart <= LIMIT, f"{case}, the limit differs from the single-domain mesh by {apart:.3g}")


def _describe(settings: Schwarz) -> str:
    columns, rows = settings.counts
    return f"with {columns} x {rows} subdomains, an overlap of {settings.overlap} and {settings.ordering} ordering"


def _unknown(row: int, shape: tuple[int, int]) -> str:
    """The unknown that a row of a subdomain's equations belongs to, in words."""
    node = np.unravel_index(row % (shape[0] * shape[1]), shape)
    return f"{'xy'[row // (shape[0] * shape[1])]} at node ({node[0]}, {node[1]})"
