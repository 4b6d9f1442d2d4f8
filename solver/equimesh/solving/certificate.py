"""The certificate of a mesh: how well it solves the requested equations, and warnings."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from equimesh.inputs import finite_or_none
from equimesh.meshes.grid import Grid
from equimesh.quality.faces import Faces
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.single_domain.steps import Mode
from equimesh.solving.status import Status

NAMES = {
    "a": "a of the arc length",
    "strength": "strength of the monitor",
    "points": "points a side of the grid it was solved on",
}
UNKNOWN = "not known"
# Errors that differ by less are called the same, as a share.
MIN_DIFFERENCE = 0.005
# Smaller ratios of errors are given in percent.
MIN_RATIO = 1.1


@dataclass(frozen=True, kw_only=True)
class Relaxed:
    """One relaxed quantity: its name ``what``, the requested value ``asked`` and the value ``reached``.

    ``"a"`` is the strength of the arc length, ``"strength"`` that of any other monitor. ``"cross_line"`` is the weight
    of the cross-line term that was added to the equations. ``"points"`` is the number of points a side of the grid on
    which the equations were solved, before the mesh was interpolated to the requested grid. ``"distortion"`` and
    ``"smoothness"`` are raised weights of a least-error monitor. ``"rectilinear"`` is 1 for straight lines. A bound of
    the angles relaxes these three or the strength.
    """

    what: str
    asked: float
    reached: float

    def __str__(self) -> str:
        if self.what == "cross_line":
            return f"cross-line term of weight {_short(self.reached)} added"
        if self.what == "rectilinear":
            return "straight lines in place of free nodes"
        return f"{NAMES.get(self.what, self.what)}: {_short(self.asked)} requested, {_short(self.reached)} reached"


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A monitor that was compared with others on a coarse grid: its ``kind``, its ``settings``, and its gains there.

    The gains are those of :class:`~equimesh.quality.interpolation.InterpolationErrors`, ``None`` where there was no
    mesh of the requested equations.
    """

    kind: str
    settings: Mapping[str, Any]
    gain_l2: float | None
    gain_h1: float | None
    chosen: bool
    gain_cells: float | None = None
    """The error at cell centres of a cell-centred code: on the uniform mesh over that on this one.

    ``None`` where the comparison is not one for finite volumes, or the candidate cannot be used.
    """

    def __str__(self) -> str:
        settings = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        gains = (
            "no valid mesh" if self.gain_l2 is None else f"{_short(self.gain_l2)} in L2, {_short(self.gain_h1)} in H1"
        )
        gains = gains if self.gain_cells is None else f"{_short(self.gain_cells)} at cell centres, {gains}"
        kind = self.kind.replace("_", " ")
        return f"{kind}{f' ({settings})' if settings else ''}: {gains}{'  (chosen)' if self.chosen else ''}"


@dataclass(frozen=True, kw_only=True)
class Aim:
    """A requested interpolation error and what was reached: ``error`` in a ``norm``, on the ``grid`` that was taken.

    ``predicted`` is the error that was expected on this grid, ``reached`` the measured one. ``solves`` counts the grids
    that were solved, the first one included.
    """

    norm: str
    error: float
    grid: Grid
    predicted: float
    reached: float
    solves: int

    def summary(self) -> dict[str, Any]:
        """The same as plain Python data, ready for JSON."""
        return {**asdict(self), "grid": [self.grid.n_xi, self.grid.n_eta]}

    def __str__(self) -> str:
        numbers = f"{_short(self.error)} in {self.norm.upper()} requested, {_short(self.predicted)} predicted"
        return f"{numbers}, {_short(self.reached)} reached on {self.grid} points"


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The estimated error of the values of a solver on their own mesh, from which a round of adapting began.

    ``l2`` is in the units of u times a length, ``h1`` that of the gradient. ``unresolved`` is ``h1`` over the
    norm of the gradient: the share that the mesh does not resolve. ``moved_cells`` is the root mean square of
    the moves of the nodes in the round, in spacings of the uniform mesh.
    """

    l2: float
    h1: float
    unresolved: float
    moved_cells: float

    def __str__(self) -> str:
        return f"{_short(self.l2)} in L2, {_short(self.h1)} in H1; nodes moved by {_short(self.moved_cells)} cells"


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """How well a mesh solves the requested equations, measured on the mesh itself wherever possible."""

    status: Status
    """How the solve ended."""
    mode: Mode | None
    """When a single-domain solve ends; ``None`` for a Schwarz iteration and for a gradient map."""
    equation_residual: float | None
    """The largest relative difference of a squared metric length from the mean of its grid line.

    It is the residual of the requested equations, also where relaxed ones were solved. It is 0 on their exact
    solution. For a gradient map it is the root mean square of the relative deviations of the cells' shares from their
    mean. ``None`` for a mesh that minimises the interpolation error, which solves no such equations.
    """
    min_jacobian: float
    """The smallest corner Jacobian: positive on every valid mesh, 1 on the uniform mesh of a rectangle.

    On a domain in blocks it is relative to the mean area of a cell.
    """
    faces: Faces
    """Non-orthogonality and skewness of the faces, as OpenFOAM defines them."""
    discretization_error: float | None = None
    """Estimate of the largest error of a node's coordinate that the grid causes, in units of the reference square.

    ``None`` where it is not known.
    """
    algebraic_error: float | None = None
    """The same for the error from stopping the iteration."""
    relaxed: tuple[Relaxed, ...] = ()
    """The differences between the requested and the solved equations; empty where there are none."""
    warnings: tuple[str, ...] = ()
    """Sentences to read before using the mesh."""
    interpolation: InterpolationErrors | None = None
    """The errors of interpolating u on the mesh and on the uniform one; ``None`` where there is no u."""
    target: Aim | None = None
    """The requested interpolation error and what was reached; ``None`` where a grid was given."""
    comparison: tuple[Candidate, ...] = ()
    """The monitors that were compared on a coarse grid, the best one first; empty where the monitor was given."""
    estimate: Estimate | None = None
    """The estimated error of the values that a round of adapting was given; ``None`` for other meshes."""
    compared_with: Literal["uniform", "initial"] = "uniform"
    """The mesh that the gains of interpolation refer to: the uniform one, on a domain in blocks the initial one."""
    understood: Mapping[str, str] = field(default_factory=dict)
    """The formulas that were typed in another spelling, as they were understood: ``{"monitor.u": "2*x"}`` for 2x."""

    @property
    def resolved(self) -> bool:
        """Whether the gains of interpolation are known: two rules of quadrature agree, or there is no u."""
        return self.interpolation is None or all(self.interpolation.resolved)

    def summary(self) -> dict[str, Any]:
        """The certificate as plain Python data, ready for JSON; a number that is not known or finite is ``None``."""
        gain = self.interpolation
        return {
            "status": str(self.status),
            "mode": None if self.mode is None else str(self.mode),
            "equation_residual": finite_or_none(self.equation_residual),
            "discretization_error": finite_or_none(self.discretization_error),
            "algebraic_error": finite_or_none(self.algebraic_error),
            "min_jacobian": finite_or_none(self.min_jacobian),
            "non_orthogonality": self.faces.summary(),
            "skewness": finite_or_none(self.faces.skewness),
            "relaxed": [{"what": r.what, "asked": r.asked, "reached": r.reached} for r in self.relaxed],
            "warnings": list(self.warnings),
            "target": self.target and self.target.summary(),
            "comparison": [asdict(candidate) for candidate in self.comparison],
            "estimate": self.estimate and asdict(self.estimate),
            "resolved": self.resolved,
            "compared_with": self.compared_with,
            "understood": dict(self.understood),
            "interpolation_gain": gain and {"l2": finite_or_none(gain.gain_l2), "h1": finite_or_none(gain.gain_h1)},
        }

    @property
    def headline(self) -> str:
        """What the mesh is worth, in one sentence."""
        if not self.status.succeeded:
            return f"The solve failed: {self.status.value.replace('_', ' ')}."
        if self.interpolation is None:
            return "The mesh is finished. There is no u, so no error of interpolation is measured."
        l2, h1 = self.interpolation.gain_l2, self.interpolation.gain_h1
        if not (math.isfinite(l2) and l2 > 0.0):
            return "The mesh is finished. How much smaller the error of interpolation is, is not known."
        (here, word), there = _compared(l2), "uniform" if self.compared_with == "uniform" else "initial"
        of_gradient = f"; that of its gradient is {_compared(h1)[0]}" if math.isfinite(h1) and h1 > 0.0 else ""
        return f"The error of interpolating u is {here} {word} on the {there} mesh{of_gradient}."

    @property
    def details(self) -> str:
        """The numbers behind the headline, one on each line, without the warnings."""
        status = self.status.value.replace("_", " ") + (f", mode {self.mode}" if self.mode else "")
        lines = [f"  status                {status}"]
        lines += [f"  read as               {place} = {text}" for place, text in self.understood.items()]
        lines += [f"  relaxed               {part}" for part in self.relaxed]
        if finite_or_none(self.equation_residual) is not None:
            residual = _short(self.equation_residual)
            lines.append(f"  equation residual     {residual}  (of squared metric lengths, relative)")
            grid, solved = _error(self.discretization_error), _error(self.algebraic_error)
            lines.append(
                f"  estimated error       {grid}"
                + ("" if grid == solved == UNKNOWN else f" of the grid, {solved} of the solution on it")
            )
        one = "the uniform mesh" if self.compared_with == "uniform" else "a parallelogram of the mean area"
        lines.append(f"  smallest Jacobian     {_short(self.min_jacobian)}  (1 for {one})")
        if finite_or_none(self.faces.non_orthogonality) is not None:
            angles = f"{_short(self.faces.non_orthogonality)} degrees, {_short(self.faces.mean_non_orthogonality)} mean"
            lines.append(f"  non-orthogonality     {angles}; skewness {_short(self.faces.skewness)}")
        if self.interpolation is not None:
            gains = f"{_short(self.interpolation.gain_l2)} in L2, {_short(self.interpolation.gain_h1)} in H1"
            lines.append(
                f"  interpolation gain    {gains}  (error on the {self.compared_with} mesh over that on this one)"
            )
        if self.target is not None:
            lines.append(f"  target                {self.target}")
        lines += [f"  compared              {candidate}" for candidate in self.comparison]
        if self.estimate is not None:
            lines.append(f"  estimate              {self.estimate}  (of the given values, on their own mesh)")
        return "\n".join(lines)

    def __str__(self) -> str:
        """The certificate in a few lines: the headline first, the warnings last."""
        return "\n".join([self.headline, self.details, *(f"  warning: {warning}" for warning in self.warnings)])


def _short(value: float | None) -> str:
    """A number in two digits."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{value:.0f}" if 100 <= abs(value) < 1e5 else f"{value:.2g}"


def _error(value: float | None) -> str:
    return "exact" if value == 0.0 else _short(value)


def _compared(gain: float) -> tuple[str, str]:
    """An error next to one that is ``gain`` times as large, and the word that leads to it."""
    if abs(gain - 1.0) < MIN_DIFFERENCE:
        return "the same", "as"
    ratio, word = (gain, "smaller") if gain > 1.0 else (1.0 / gain, "larger")
    if ratio >= MIN_RATIO:
        return f"{_short(ratio)} times {word}", "than"
    return f"{100.0 * abs(1.0 - 1.0 / gain):.2g} % {word}", "than"
