"""The certificate of a mesh: how well it solves the requested equations, and warnings."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from equimesh_schema.document import Answer, Json, Number
from equimesh_schema.notebook import html_of

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
FAILED = ("not_converged", "newton_failed", "folded")


@dataclass(frozen=True, kw_only=True)
class Relaxed(Answer):
    """An option whose requested value was not reached.

    ``"a"`` is the strength of the arc length, ``"strength"`` that of any other monitor. ``"cross_line"`` is the weight
    of the cross-line term that was added to the equations. ``"points"`` is the number of points a side of the grid on
    which the equations were solved, before the mesh was interpolated to the requested grid. ``"distortion"`` and
    ``"smoothness"`` are raised weights of a least-error monitor. ``"rectilinear"`` is 1 for straight lines. A bound of
    the angles relaxes these three or the strength.
    """

    what: str
    """a (of the arc length), strength (of other monitors), cross_line, points, distortion, smoothness, rectilinear."""
    asked: float
    """The requested value."""
    reached: float
    """The value that the mesh has."""

    def __str__(self) -> str:
        if self.what == "cross_line":
            return f"cross-line term of weight {_short(self.reached)} added"
        if self.what == "rectilinear":
            return "straight lines in place of free nodes"
        return f"{NAMES.get(self.what, self.what)}: {_short(self.asked)} requested, {_short(self.reached)} reached"


@dataclass(frozen=True, kw_only=True)
class Candidate(Answer):
    """A monitor that was compared with others on a coarse grid.

    The gains are nan where there was no mesh of the requested equations, in JSON null.
    """

    kind: str
    """The kind of the monitor."""
    settings: Mapping[str, Any]
    """The settings of the monitor."""
    gain_l2: Number
    """Gain in L2 on the coarse grid."""
    gain_h1: Number
    """Gain in the norm h1 on the coarse grid."""
    chosen: bool
    """Whether the mesh has this monitor."""
    gain_cells: Number = math.nan
    """Error at cell centres of a cell-centred code: of the uniform mesh over that of this one.

    Not known where the comparison is not one for finite volumes, or the candidate cannot be used.
    """
    gain_solver: Number = math.nan
    """Error of a finite element solver: of the uniform mesh over that of this one.

    Not known where the comparison is not one for finite elements.
    """

    def __str__(self) -> str:
        settings = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        gains = f"{_short(self.gain_l2)} in L2, {_short(self.gain_h1)} in H1"
        gains = gains if math.isfinite(self.gain_l2) else "no valid mesh"
        if math.isfinite(self.gain_cells):
            gains = f"{_short(self.gain_cells)} at cell centres, {gains}"
        if math.isfinite(self.gain_solver):
            gains = f"{_short(self.gain_solver)} for a solver, {gains}"
        kind = self.kind.replace("_", " ")
        return f"{kind}{f' ({settings})' if settings else ''}: {gains}{'  (chosen)' if self.chosen else ''}"


@dataclass(frozen=True, kw_only=True)
class Aim(Answer):
    """A requested interpolation error and what was reached."""

    norm: str
    """The norm of the errors, l2 or h1."""
    error: float
    """The requested one."""
    grid: tuple[int, int]
    """The grid that was taken, n_xi and n_eta."""
    predicted: Number
    """The error that was expected on this grid."""
    reached: Number
    """The measured error."""
    solves: int
    """Grids that were solved to find it, the first one included."""

    def __str__(self) -> str:
        numbers = f"{_short(self.error)} in {self.norm.upper()} requested, {_short(self.predicted)} predicted"
        return f"{numbers}, {_short(self.reached)} reached on {' x '.join(map(str, self.grid))} points"


@dataclass(frozen=True, kw_only=True)
class ErrorProducts(Answer):
    """Integrals of products of the estimated errors of a solution u and of its adjoint z.

    Times the coefficients of an equation they are the error of the functional whose adjoint z is.
    """

    bound: float
    """Sum over the cells of the norms of the errors of both gradients."""
    diffusion: float
    """Integral of the product of both errors of the gradient."""
    stream_x: float
    """Integral of the error of the x-derivative of u times the error of z."""
    stream_y: float
    """The same for the y-derivative."""
    reaction: float
    """Integral of the product of the errors of u and z."""


@dataclass(frozen=True, kw_only=True)
class Estimate(Answer):
    """The estimated error of the values of a solver, from which a round of adapting began, on their own mesh."""

    l2: float
    """In the units of u times a length."""
    h1: float
    """Estimated error of the gradient; it must not rank meshes."""
    unresolved: float
    """h1 over the norm of the gradient: the share that the mesh does not resolve."""
    moved_cells: float
    """Root mean square of the moves of the nodes in the round, in spacings of the uniform mesh."""
    products: ErrorProducts | None = None
    """What tells the error of a functional, where an adjoint is given. h1 is then the root of its bound."""

    def __str__(self) -> str:
        return f"{_short(self.l2)} in L2, {_short(self.h1)} in H1; nodes moved by {_short(self.moved_cells)} cells"


@dataclass(frozen=True, kw_only=True)
class FaceAngles(Answer):
    """Angles between the normal of an inner face and the line of its two cell centres, as OpenFOAM measures them."""

    max: Number = math.nan
    """The largest, in degrees; null for a folded mesh."""
    mean: Number = math.nan
    """The angle whose cosine is the mean of their cosines, in degrees."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InterpolationGain(Answer, Mapping[str, float]):
    """How many times smaller the interpolation error is than on the uniform mesh, or on the initial one of blocks.

    That mesh has the same numbers of cells, also where these were chosen for a number of points. The gain is also a
    mapping of the two norms.
    """

    l2: Number
    """Of u itself; nan, in JSON null, where a layer of u lies inside a cell."""
    h1: Number
    """Of the gradient of u."""

    def __getitem__(self, norm: str) -> float:
        return {"l2": self.l2, "h1": self.h1}[norm]

    def __iter__(self) -> Iterator[str]:
        return iter(("l2", "h1"))

    def __len__(self) -> int:
        return 2


@dataclass(frozen=True, kw_only=True, eq=False)
class SolverGain(InterpolationGain):
    """How many times smaller the error of a solver is than on the uniform mesh, or on the initial one of blocks.

    The solver has bilinear finite elements, on triangles linear ones, and solves Poisson's equation with u as solution.
    It is also a mapping of the two norms.
    """

    points: int
    """Nodes of the two meshes on which it was measured; fewer than the mesh has where that is large."""


@dataclass(frozen=True, kw_only=True)
class DegreeGain(Answer):
    """How many times smaller the interpolation error of elements of one degree is than on the uniform mesh.

    On blocks it is compared with the initial mesh. The gains are estimates from some of the cells, but for the degree
    of the mesh.
    """

    degree: int
    """The degree of the element: 1 is bilinear, 2 biquadratic, 3 bicubic; on triangles linear and quadratic."""
    l2: Number
    """Of u itself; nan, in JSON null, where a layer of u lies inside a cell."""
    h1: Number
    """Of the gradient of u."""

    def __str__(self) -> str:
        return f"degree {self.degree}: {_short(self.l2)} in L2, {_short(self.h1)} in H1"


@dataclass(frozen=True, kw_only=True)
class Certificate(Answer):
    """How well a mesh solves the requested equations. A number that is not known is nan, in JSON null."""

    JSON_NAMES: ClassVar[Mapping[str, str]] = {"angles": "non_orthogonality"}

    status: str
    """How the solve ended, as in convergence; relaxed: for a weaker or smoother monitor than requested."""
    mode: str | None
    """When a single-domain solve ended; null for a Schwarz iteration, which has a tolerance of its own."""
    equation_residual: float | None
    """Largest relative difference of a squared metric length from the mean of its grid line.

    null for a mesh that solves no equations.
    """
    discretization_error: Number
    """Estimated error of the nodes that a finer grid would remove, in units of the reference square."""
    algebraic_error: Number
    """Estimated error of the solution of the discrete equations, in the same units."""
    min_jacobian: Number
    """Smallest corner Jacobian; 1 for the uniform mesh. Of blocks over the mean area of a cell."""
    angles: FaceAngles | None = None
    """The angles of its faces; null for a mesh made before they were measured."""
    skewness: Number = math.nan
    """The largest skewness of a face, as OpenFOAM defines it."""
    relaxed: tuple[Relaxed, ...]
    """The differences between the requested and the solved equations."""
    warnings: tuple[str, ...]
    """Sentences: what a user of the mesh should know."""
    resolved: bool = True
    """Whether the gains are known; false where a layer of u lies inside a cell: they are null."""
    interpolation_gain: InterpolationGain | None
    """The error on another mesh over that on this one; null without a u."""
    degree: int = 1
    """The degree of the elements that interpolate u: that of the request, for which the mesh is made."""
    gains_by_degree: tuple[DegreeGain, ...] = ()
    """The same for elements of degree 1, 2 and 3, on triangles 1 and 2, and of the degree of the request.

    Empty without a u, and of a failed mesh.
    """
    solver_gain: SolverGain | None = None
    """The error of a solver on the other mesh over that on this one.

    It is measured for meshes of least error and of auto for degree 1; null for others, without a u, and in large
    blocks.
    """
    target: Aim | None = None
    """The requested error and what was reached; null where a grid was given."""
    comparison: tuple[Candidate, ...] = ()
    """The monitors among which auto has chosen, the best one first."""
    estimate: Estimate | None = None
    """Estimated errors of a round of adapting; null for other meshes."""
    compared_with: Literal["uniform", "initial"] = "uniform"
    """The mesh that the gains refer to, of the same numbers of cells; initial for a domain in blocks."""
    understood: Mapping[str, str] = field(default_factory=dict)
    """Formulas that were typed in another spelling, as they were understood, by their place."""

    @property
    def non_orthogonality(self) -> float:
        """The largest angle between the normal of a face and the line of its two cell centres, in degrees."""
        return math.nan if self.angles is None else self.angles.max

    @property
    def mean_non_orthogonality(self) -> float:
        """The angle whose cosine is the mean of their cosines, in degrees."""
        return math.nan if self.angles is None else self.angles.mean

    @property
    def record(self) -> Json:
        """The certificate in JSON."""
        return self.to_json()

    @property
    def headline(self) -> str:
        """What the mesh is worth, in one sentence."""
        if self.status in FAILED:
            return f"The solve failed: {self.status.replace('_', ' ')}."
        if self.interpolation_gain is None:
            return "The mesh is finished. There is no u, so no error of interpolation is measured."
        l2, h1 = self.interpolation_gain.l2, self.interpolation_gain.h1
        if not is_known(l2):
            return "The mesh is finished. How much smaller the error of interpolation is, is not known."
        solver = math.nan if self.solver_gain is None else self.solver_gain.l2
        if is_known(solver):
            rest = f"; that of interpolating u is {compared(l2)[0]}"
            return f"A solver's error is {self._than_there(solver)}{rest}."
        of_gradient = f"; that of its gradient is {compared(h1)[0]}" if is_known(h1) else ""
        by = f" by elements of degree {self.degree}" if self.degree > 1 else ""
        return f"The error of interpolating u{by} is {self._than_there(l2)}{of_gradient}."

    def _than_there(self, gain: float) -> str:
        here, word = compared(gain)
        return f"{here} {word} on the {'uniform' if self.compared_with == 'uniform' else 'initial'} mesh"

    @property
    def facts(self) -> list[tuple[str, str]]:
        """The numbers behind the headline, each with its name, without the warnings."""
        status = self.status.replace("_", " ") + (f", mode {self.mode}" if self.mode else "")
        rows = [("status", status)]
        rows += [("read as", f"{place} = {text}") for place, text in self.understood.items()]
        rows += [("relaxed", str(part)) for part in self.relaxed]
        if self.equation_residual is not None and math.isfinite(self.equation_residual):
            residual = _short(self.equation_residual)
            rows.append(("equation residual", f"{residual}  (of squared metric lengths, relative)"))
            grid, solved = _error(self.discretization_error), _error(self.algebraic_error)
            rest = "" if grid == solved == UNKNOWN else f" of the grid, {solved} of the solution on it"
            rows.append(("estimated error", grid + rest))
        one = "the uniform mesh" if self.compared_with == "uniform" else "a parallelogram of the mean area"
        rows.append(("smallest Jacobian", f"{_short(self.min_jacobian)}  (1 for {one})"))
        if math.isfinite(self.non_orthogonality):
            angles = f"{_short(self.non_orthogonality)} degrees, {_short(self.mean_non_orthogonality)} mean"
            rows.append(("non-orthogonality", f"{angles}; skewness {_short(self.skewness)}"))
        if self.interpolation_gain is not None:
            of = f"(error on the {self.compared_with} mesh over that on this one)"
            rows.append(("interpolation gain", f"{_of_norms(self.interpolation_gain)}  {of}"))
        if self.gains_by_degree:
            rows.append(("by degree", "; ".join(map(str, self.gains_by_degree))))
        if self.solver_gain is not None:
            of = "(the same of a finite element solver whose solution is u)"
            rows.append(("solver gain", f"{_of_norms(self.solver_gain)}  {of}"))
        if self.target is not None:
            rows.append(("target", str(self.target)))
        rows += [("compared", str(candidate)) for candidate in self.comparison]
        if self.estimate is not None:
            rows.append(("estimate", f"{self.estimate}  (of the given values, on their own mesh)"))
        return rows

    @property
    def details(self) -> str:
        """The :attr:`facts`, one on each line."""
        return "\n".join(f"  {name:<20}  {text}" for name, text in self.facts)

    def _repr_html_(self) -> str:
        """A table, for notebooks."""
        return html_of(self.headline, self.facts, self.warnings)

    def table(self) -> str:
        """The certificate in a few lines: the headline first, the warnings last."""
        return "\n".join([self.headline, self.details, *(f"  warning: {warning}" for warning in self.warnings)])

    def __str__(self) -> str:
        return self.table()


def _short(value: float | None) -> str:
    """A number in two digits."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{value:.0f}" if 99.5 <= abs(value) < 1e5 else f"{value:.2g}"


def _of_norms(gains: Mapping[str, float]) -> str:
    return ", ".join(f"{_short(value)} in {name.upper()}" for name, value in gains.items())


def _error(value: float | None) -> str:
    return "exact" if value == 0.0 else _short(value)


def is_known(gain: float | None) -> bool:
    """Whether a gain is a number that can be told."""
    return gain is not None and math.isfinite(gain) and gain > 0.0


def compared(gain: float) -> tuple[str, str]:
    """An error next to one that is ``gain`` times as large, and the word that leads to it: ``as`` for the same."""
    if abs(gain - 1.0) < MIN_DIFFERENCE:
        return "the same", "as"
    ratio, word = (gain, "smaller") if gain > 1.0 else (1.0 / gain, "larger")
    if ratio >= MIN_RATIO:
        return f"{_short(ratio)} times {word}", "than"
    return f"{100.0 * abs(1.0 - 1.0 / gain):.2g} % {word}", "than"
