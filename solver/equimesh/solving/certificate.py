"""The certificate of a solution: its measures, and the warnings about its mesh."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import equimesh_schema
from equimesh.equations.newton_solve import smallest_residual
from equimesh.equations.problem import Problem
from equimesh.fields.chunked_samples import ChunkedSamples, steps_of
from equimesh.fields.expression import Field
from equimesh.fields.noise import noise_share
from equimesh.fields.samples import GridSamples
from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import MeshRows
from equimesh.monitors.metrics import ArcLength
from equimesh.monitors.monitor import orthogonality_of
from equimesh.numerics.types import Pair
from equimesh.quality.cells import AnyMesh
from equimesh.quality.faces import Faces
from equimesh.quality.interpolation import InterpolationErrors, probe_errors
from equimesh.quality.measures import CutOff, measure_cut_off
from equimesh.single_domain.level import Mode
from equimesh.solving.status import Status
from equimesh_schema import Relaxed
from equimesh_schema.certificate import DegreeGain, FaceAngles, InterpolationGain
from equimesh_schema.document import Json

# Error estimates of a certificate: those of the solve times a factor, so that they err on the safe side.
#
# The factors are from 200 random problems: the true errors are below the products in 95 % of 200 other random
# problems (``benchmarks/error_estimates.py``).

# The estimate from the last moves of the iteration is too small where its contraction still grows.
ALGEBRAIC_SAFETY = 2.0
# The estimate from a coarser grid is too small where u is not yet resolved there, so that the order is below two.
DISCRETIZATION_SAFETY = 2.5


def safe_algebraic_error(estimate: float | None) -> float | None:
    """The estimated error from stopping the iteration, on the safe side; ``None`` where it is not known."""
    return None if estimate is None else finite_or_none(ALGEBRAIC_SAFETY * estimate)


def safe_discretization_error(estimate: float | None) -> float | None:
    """The estimated error of the grid, on the safe side; ``None`` where it is not known."""
    return None if estimate is None else finite_or_none(DISCRETIZATION_SAFETY * estimate)


ELEMENTS = {1: "bilinear", 2: "quadratic", 3: "cubic", 4: "quartic"}
"""The names of elements of each degree."""
MEASURED = ("faces", "interpolation")
"""The fields that are answered by those that follow from them."""


@dataclass(frozen=True, kw_only=True)
class Certificate(equimesh_schema.Certificate):
    """How well a mesh solves the requested equations, measured on the mesh itself wherever possible.

    The residual is that of the requested equations, also where relaxed ones were solved: 0 on their exact solution. For
    a gradient map it is the root mean square of the relative deviations of the cells' shares from their mean.
    """

    status: Status
    """The end of the solve."""
    mode: Mode | None
    """The condition that ends a single-domain solve; ``None`` for a Schwarz iteration and for a gradient map."""
    faces: Faces
    """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
    discretization_error: float | None = None  # type: ignore[assignment]
    """Estimate of the largest error of a node's coordinate that the grid causes, in units of the reference square.

    ``None`` where it is not known.
    """
    algebraic_error: float | None = None  # type: ignore[assignment]
    """Estimate of the largest error from stopping the iteration, in the same units; ``None`` where it is not known."""
    relaxed: tuple[equimesh_schema.Relaxed, ...] = ()
    """The differences between the requested and the solved equations; empty where there are none."""
    warnings: tuple[str, ...] = ()
    """Sentences to read before using the mesh."""
    interpolation: InterpolationErrors | None = None
    """The errors of interpolating u on the mesh and on the uniform one; ``None`` where there is no u."""
    angles: FaceAngles | None = field(default=None, init=False, repr=False)
    """The angles of ``faces``."""
    skewness: float = field(default=0.0, init=False, repr=False)
    """The skewness of ``faces``."""
    resolved: bool = field(default=True, init=False, repr=False)
    """Whether the gains of interpolation are known: two rules of quadrature agree, or there is no u."""
    interpolation_gain: InterpolationGain | None = field(default=None, init=False, repr=False)
    """The gains of ``interpolation``."""
    degree: int = field(default=1, init=False, repr=False)
    """The degree of the elements of ``interpolation``."""

    def __post_init__(self) -> None:
        faces, errors = self.faces, self.interpolation
        angles = FaceAngles(max=faces.non_orthogonality, mean=faces.mean_non_orthogonality)
        gain = None if errors is None else InterpolationGain(l2=errors.gain_l2, h1=errors.gain_h1)
        resolved = errors is None or all(errors.resolved)
        degree = 1 if errors is None else errors.degree
        derived = {
            "degree": degree,
            "angles": angles,
            "skewness": faces.skewness,
            "resolved": resolved,
            "interpolation_gain": gain,
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def to_json(self) -> Json:
        """The certificate in JSON; a number that is not known or finite is ``None``."""
        return {name: value for name, value in super().to_json().items() if name not in MEASURED}

    def summary(self) -> Json:
        """The certificate as plain Python data, ready for JSON; a number that is not known or finite is ``None``."""
        return self.to_json()


# Warnings about a mesh: sentences to read before using it.

# A mesh whose L2 gain is smaller interpolates u worse than the uniform mesh by a hundredth, and deserves a warning.
MIN_GAIN = 0.99
# The same for the H1 gain of a mesh whose L2 gain is not warned of, and for the estimated gain of other degrees.
MIN_GAIN_H1, MIN_ESTIMATED_GAIN = 0.9, 0.9
# A residual that rounding alone causes deserves a warning above this.
MAX_SILENT_ROUNDING = 1e-6
# Largest error of interpolation, as a share of the range of u, that a mesh may have without a warning.
MAX_ERROR_SHARE = 0.25
# The same for a uniform mesh of a monitor that does not see u.
MAX_UNIFORM_ERROR_SHARE = 0.05
# A u that varies by less, as a share of its size, may count as constant or linear because of rounding.
MIN_VARIATION_SHARE = 1e-8
# Noise of this share of the range of u deserves a warning: meshes then begin to follow it.
MIN_NOISE_SHARE = 5e-4
# Neighbouring samples that differ by more, as a share of the range of u, deserve a warning.
MAX_SAMPLE_STEP_SHARE = 0.4
# Cells with a smaller Jacobian, 1 for the uniform mesh, deserve a warning: solvers round there.
MIN_SILENT_JACOBIAN = 1e-6
# Faces with a larger angle, in degrees, deserve a warning: corrections of fluxes diverge there.
MAX_SILENT_ANGLE = 60.0
# Cells that cut off more of a domain at its curved sides, as a share, deserve a warning.
MAX_SILENT_CUT_OFF = 0.01
# A mesh is uniform when no coordinate of a node is further from the uniform mesh, as a share of the spacing.
MAX_UNIFORM_MOVE = 0.01
# Every so many nodes are compared with it first.
LATTICE = 16


def warnings(
    problem: Problem[Any],
    status: Status,
    relaxed: Sequence[Relaxed],
    meshes: tuple[AnyMesh, AnyMesh],
    errors: InterpolationErrors | None,
    gains: Sequence[DegreeGain],
) -> Iterator[str]:
    """Sentences to read before using a mesh. ``meshes`` are the mesh of the domain and its reference mesh.

    ``gains`` are those of elements of each degree.
    """
    is_grid = meshes[0].is_grid
    other = "uniform" if is_grid else "initial"
    if status is Status.RELAXED:
        what = ", ".join(map(str, relaxed))
        yield f"The mesh solves relaxed equations, not the requested ones: {what}."
    if is_grid:
        yield from _about_rounding(problem, status)
    if errors is None or status is Status.FOLDED:
        return
    yield from _about_noise(problem.monitor.u)
    yield from _about_jumps(problem.monitor.u)
    more = "Add grid points" if is_grid else "Give the blocks more cells"
    yield from _about_resolution(errors, more)
    if status.succeeded:
        yield from _about_thin_cells(meshes[0].min_jacobian / (problem.domain.area if is_grid else 1.0))
        yield from _about_structure(problem, meshes, errors, relaxed, more)
        yield from about_cut_off(measure_cut_off(problem.domain, meshes[1]), more)
    yield from _about_gains(errors, other)
    yield from about_degrees(gains, errors, other)


def about_cut_off(cut: CutOff, more: str) -> Iterator[str]:
    """A warning about long cells, which cut off the curved sides of a domain; ``more`` begins the remedy."""
    if cut.is_much or cut.share > MAX_SILENT_CUT_OFF:
        yield (
            f"Between the curved sides of the domain and the cells lie {_percent(cut.share)} of its area,"
            f" {_percent(cut.initial)} with the mesh before adapting, since long cells cut the sides off. The error is"
            f" measured on the cells alone, and the gain can be flattered. {more}, or raise distortion."
        )


def _about_rounding(problem: Problem, status: Status) -> Iterator[str]:
    floor = smallest_residual(problem.metric, problem.grid.shape)
    if floor > MAX_SILENT_ROUNDING and status.succeeded:
        yield (
            f"Rounding errors of u alone cause a residual of up to {floor:.0e}, since u is"
            f" {problem.metric.cancellation:.0e} times as large as it varies: subtract a constant from u."
        )


def _about_noise(u: Field | None) -> Iterator[str]:
    share = noise_share(u)
    if share >= MIN_NOISE_SHARE:
        yield (
            f"The samples of u have noise of about {_percent(share)} of their range. The mesh follows the noise, and"
            " the gains are those of the noisy samples: smooth the samples before, or give u as an expression."
        )


def _about_jumps(u: Field | None) -> Iterator[str]:
    """A jump between neighbouring samples: a mesh can resolve only the spline through them."""
    if not isinstance(u, GridSamples | ChunkedSamples):
        return
    size, steps = (u.found.size, u.found.steps) if isinstance(u, ChunkedSamples) else steps_of(u.values)
    step = max(steps, key=lambda step: step.size)
    if step.size > MAX_SAMPLE_STEP_SHARE * size > 0.0:
        yield (
            f"The samples of u change by {_percent(step.size / size)} of their range between two"
            f" neighbours near (x, y) = ({u.x[step.i]:.4g}, {u.y[step.j]:.4g}). The mesh and its gains are those of the"
            " spline through the samples, not of u: send more samples there, or give u as an expression."
        )


def _about_thin_cells(smallest: float) -> Iterator[str]:
    if 0.0 < smallest < MIN_SILENT_JACOBIAN:
        yield (
            f"The smallest Jacobian of a cell is {smallest:.1e} of that of the uniform mesh: u has a kink or a layer as"
            " thin as that. Solvers lose digits in such cells; raise the smoothness or the radius of smoothing."
        )


def _about_resolution(errors: InterpolationErrors, more: str) -> Iterator[str]:
    if not all(errors.resolved):
        names = [name for name, known in zip(("L2", "H1"), errors.resolved, strict=True) if not known]
        yield (
            f"A layer, a jump or a kink of u lies inside a cell: the {' and the '.join(names)} gain is not known, as"
            f" two rules of quadrature do not agree. {more}, or replace a jump by a steep tanh."
        )


def _about_structure(
    problem: Problem[Any],
    meshes: tuple[AnyMesh, AnyMesh],
    errors: InterpolationErrors,
    relaxed: Sequence[Relaxed],
    more: str,
) -> Iterator[str]:
    """Warnings of features of u that the monitor or the grid misses."""
    mesh, reference = meshes
    u = problem.monitor.u
    if u is None or errors.largest is None:
        return
    variation, uniform = errors.variation, reference.is_grid and _is_uniform(MeshRows.of(reference))
    if errors.l2 <= errors.rounding[0] and 0.0 < variation < MIN_VARIATION_SHARE * errors.size:
        yield (
            f"u counts as constant or linear: it varies by {variation:.2g}, and its size is {errors.size:.2g}. If it is"
            " not, subtract a constant from it."
        )
    elif uniform:
        yield from _about_uniformity(problem, mesh, u, errors, relaxed)
    else:
        yield from _about_large_errors(errors, more)


def _about_large_errors(errors: InterpolationErrors, more: str) -> Iterator[str]:
    if errors.largest is None:
        return
    (error, x, y), variation = errors.largest, errors.variation
    if error > MAX_ERROR_SHARE * variation and error > errors.rounding[0]:
        yield (
            f"Between the nodes near (x, y) = ({x:.4g}, {y:.4g}) u differs from its interpolant by"
            f" {_percent(error / variation)} of its range: the mesh does not resolve it. {more}."
        )


def _about_uniformity(
    problem: Problem, mesh: AnyMesh, u: Field, errors: InterpolationErrors, relaxed: Sequence[Relaxed]
) -> Iterator[str]:
    """A warning where the mesh is uniform although u is not constant: u is evaluated at many more points."""
    monitor = problem.monitor
    if isinstance(monitor, ArcLength) and monitor.a == 0.0:
        return
    (error, x, y), variation = probe_errors(mesh, u)
    share = error / variation if variation > 0.0 else 0.0
    blind = isinstance(monitor, ArcLength) and errors.l2 > errors.rounding[0]
    if not (blind or (share > MAX_UNIFORM_ERROR_SHARE and error > errors.rounding[0])):
        return
    bound = orthogonality_of(monitor)
    why = "the monitor sees nothing of u at the points where it is evaluated."
    if relaxed:
        why = "of the relaxed monitor next to nothing is left."
    if relaxed and bound is not None:
        why = f"the bound of {bound:g} degrees of non-orthogonality leaves next to nothing of the monitor."
        advice = "Raise orthogonality."
    elif isinstance(monitor, ArcLength) and not monitor.scaled:
        advice = "Take a scaled arc length, so that the units of u do not matter."
    else:
        advice = "Add grid points, or take another monitor; replace a jump by a steep tanh."
    yield (
        f"The mesh is uniform although u varies by {variation:.2g}: {why} Near (x, y) = ({x:.4g}, {y:.4g}) u differs"
        f" from its interpolant by {_percent(share)} of its range. {advice}"
    )


def _about_gains(errors: InterpolationErrors, other: str = "uniform") -> Iterator[str]:
    """Warnings where the ``other`` mesh interpolates u or its gradient better."""
    if errors.gain_l2 < MIN_GAIN:
        if errors.l2_uniform <= errors.rounding[0]:
            yield f"The {other} mesh interpolates u exactly, and this one does not: there is nothing to adapt to."
        elif errors.gain_l2 > 0.0:
            yield (
                f"The mesh interpolates u worse than the {other} one: its L2 error is {1 / errors.gain_l2:.3g} times as"
                " large. Take the curvature monitor to interpolate u well."
            )
    elif 0.0 < errors.gain_h1 < MIN_GAIN_H1 and errors.h1_uniform > errors.rounding[1]:
        yield (
            f"The mesh interpolates the gradient of u worse than the {other} one: its H1 error is"
            f" {1 / errors.gain_h1:.2g} times as large. If you need the gradient, for fluxes or stresses, adapt with"
            " norm h1."
        )


def about_degrees(gains: Sequence[DegreeGain], errors: InterpolationErrors, other: str = "uniform") -> Iterator[str]:
    """A warning where elements of other degrees than that of the ``errors`` lose against the ``other`` mesh.

    There is none where those of that degree lose, too.
    """
    if errors.gain_l2 < MIN_GAIN:
        return
    worse = [one for one in gains if one.degree != errors.degree and 0.0 < one.l2 < MIN_ESTIMATED_GAIN]
    if worse:
        losses = [f"about {1 / one.l2:.2g} times for {ELEMENTS[one.degree]} elements" for one in worse]
        yield (
            f"The L2 error of interpolation is larger on this mesh than on the {other} one, {' and '.join(losses)}."
            " If your elements are such, make the mesh for them: take least_error or auto with their degree."
        )


def about_faces(faces: Faces) -> Iterator[str]:
    """A warning for codes with fluxes between cell centres."""
    if faces.non_orthogonality > MAX_SILENT_ANGLE:
        yield (
            f"Between the normal of a face and the line of its two cell centres there are up to"
            f" {faces.non_orthogonality:.0f} degrees. Finite elements can use such a mesh. Finite-volume codes often"
            f" diverge over {MAX_SILENT_ANGLE:.0f} degrees: bound the angle by orthogonality, 50 for instance."
        )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 else f"{100 * share:.2g} %"


def _is_uniform(reference: MeshRows) -> bool:
    rows = reference.rows
    s, t = (np.linspace(0.0, 1.0, count) for count in rows.shape)
    for step in (LATTICE, 1):  # a few nodes show that a mesh is not uniform
        moves = [
            _largest_move(reference.nodes(first, last), (s[first : last + 1], t), (-first) % step, step)
            for first, last in rows.strips
        ]
        found = rows.joined(np.array(moves).reshape(-1, 2)).max(axis=0)
        if max(found[0] * rows.cells[0], found[1] * rows.cells[1]) >= MAX_UNIFORM_MOVE:
            return False
    return True


def _largest_move(nodes: Pair, uniform: Pair, start: int, step: int) -> tuple[float, float]:
    """The largest differences to the uniform mesh, of every ``step``-th column in such rows from row ``start`` on."""
    rows, columns = slice(start, None, step), slice(None, None, step)
    along_xi = np.abs(nodes[0][rows, columns] - uniform[0][rows, None]).max(initial=0.0)
    return along_xi, np.abs(nodes[1][rows, columns] - uniform[1][columns]).max(initial=0.0)
