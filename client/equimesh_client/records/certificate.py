"""The certificate of a mesh: how well it solves the requested equations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from equimesh_client.records.tables import real_or_nan

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
class Relaxed:
    """One relaxed requirement: ``what`` is ``"a"``, ``"strength"``, ``"cross_line"`` or ``"points"``.

    A bound of the angles relaxes the first two, or ``"distortion"``, ``"smoothness"`` and ``"rectilinear"``.

    ``asked`` is the requested value, ``reached`` the value that the mesh has.
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

    The gains are nan where there was no mesh of the requested equations. ``gain_cells`` is that of the error at cell
    centres, nan where the mesh is not for finite volumes.
    """

    kind: str
    settings: Mapping[str, Any]
    gain_l2: float
    gain_h1: float
    chosen: bool
    gain_cells: float = math.nan

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Candidate:
        """The candidate in the JSON of the service."""
        return cls(
            kind=str(record["kind"]),
            settings=dict(record.get("settings") or {}),
            gain_l2=real_or_nan(record.get("gain_l2")),
            gain_h1=real_or_nan(record.get("gain_h1")),
            chosen=bool(record.get("chosen")),
            gain_cells=real_or_nan(record.get("gain_cells")),
        )

    def __str__(self) -> str:
        settings = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        gains = f"{_short(self.gain_l2)} in L2, {_short(self.gain_h1)} in H1"
        if math.isfinite(self.gain_cells):
            gains = f"{_short(self.gain_cells)} at cell centres, {gains}"
        shown = "no valid mesh" if math.isnan(self.gain_l2) else gains
        kind = self.kind.replace("_", " ")
        return f"{kind}{f' ({settings})' if settings else ''}: {shown}{'  (chosen)' if self.chosen else ''}"


@dataclass(frozen=True, kw_only=True)
class Aim:
    """A requested interpolation error and what was reached: ``error`` in a ``norm``, on the ``grid`` that was taken.

    ``predicted`` is the error that was expected on this grid, ``reached`` the measured one. ``solves`` counts the grids
    that were solved.
    """

    norm: str
    error: float
    grid: tuple[int, int]
    predicted: float
    reached: float
    solves: int

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Aim:
        """The target in the JSON of the service."""
        n_xi, n_eta = record["grid"]
        return cls(
            norm=str(record["norm"]),
            error=real_or_nan(record["error"]),
            grid=(int(n_xi), int(n_eta)),
            predicted=real_or_nan(record.get("predicted")),
            reached=real_or_nan(record.get("reached")),
            solves=int(record.get("solves") or 0),
        )

    def __str__(self) -> str:
        numbers = f"{_short(self.error)} in {self.norm.upper()} requested, {_short(self.predicted)} predicted"
        return f"{numbers}, {_short(self.reached)} reached on {self.grid[0]} x {self.grid[1]} points"


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

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Estimate:
        """The estimate in the JSON of the service."""
        return cls(**{name: real_or_nan(record.get(name)) for name in ("l2", "h1", "unresolved", "moved_cells")})

    def __str__(self) -> str:
        return f"{_short(self.l2)} in L2, {_short(self.h1)} in H1; nodes moved by {_short(self.moved_cells)} cells"


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """How well a mesh solves the requested equations; nan for what is not known.

    ``status`` is that of the solve, e.g. ``"converged"`` or ``"relaxed"``. ``equation_residual`` is the largest
    relative difference of a squared metric length from the mean of its grid line, None for a mesh that solves no
    equations. ``discretization_error`` and ``algebraic_error`` estimate errors of the nodes in units of the reference
    square. ``min_jacobian`` is 1 for the uniform mesh; on a domain in blocks it is relative to the mean area of a cell.
    ``non_orthogonality`` and ``mean_non_orthogonality`` are angles between the normal of a face and the line of its two
    cell centres, in degrees; these and ``skewness`` are defined as in OpenFOAM's ``checkMesh``. ``relaxed`` lists the
    relaxed requirements, ``warnings`` are sentences. ``interpolation_gain`` is the error on another mesh over that on
    this one, in the norms ``"l2"`` and ``"h1"``; None without a u. ``compared_with`` names the other mesh:
    ``"uniform"``, or ``"initial"`` on a domain in blocks. ``resolved`` is False where a gain is not known, because a
    layer of u lies inside a cell; it is nan then. ``target`` is the requested error and what was reached, None where a
    grid was given. ``comparison`` lists the monitors among which ``auto`` has chosen, the best one first. ``estimate``
    is that of a round of adapting. ``understood`` has the formulas that were typed in another spelling, as they were
    understood, by their place. ``record`` is the JSON of the service.
    """

    status: str
    mode: str
    equation_residual: float | None
    discretization_error: float
    algebraic_error: float
    min_jacobian: float
    non_orthogonality: float = math.nan
    mean_non_orthogonality: float = math.nan
    skewness: float = math.nan
    relaxed: tuple[Relaxed, ...]
    warnings: tuple[str, ...]
    resolved: bool
    interpolation_gain: Mapping[str, float] | None
    target: Aim | None = None
    comparison: tuple[Candidate, ...] = ()
    estimate: Estimate | None = None
    compared_with: str = "uniform"
    understood: Mapping[str, str] = field(default_factory=dict)
    record: Mapping[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Certificate:
        """The certificate in the JSON of the service, or of ``equimesh``'s ``Certificate.summary()``."""
        gain, residual = record.get("interpolation_gain"), record.get("equation_residual")
        angles = record.get("non_orthogonality") or {}
        return cls(
            status=str(record.get("status") or ""),
            mode=str(record.get("mode") or ""),
            equation_residual=None if residual is None else real_or_nan(residual),
            discretization_error=real_or_nan(record.get("discretization_error")),
            algebraic_error=real_or_nan(record.get("algebraic_error")),
            min_jacobian=real_or_nan(record.get("min_jacobian")),
            non_orthogonality=real_or_nan(angles.get("max")),
            mean_non_orthogonality=real_or_nan(angles.get("mean")),
            skewness=real_or_nan(record.get("skewness")),
            relaxed=tuple(
                Relaxed(
                    what=str(part["what"]),
                    asked=real_or_nan(part.get("asked")),
                    reached=real_or_nan(part.get("reached")),
                )
                for part in record.get("relaxed") or ()
            ),
            warnings=tuple(map(str, record.get("warnings") or ())),
            resolved=bool(record.get("resolved", True)),
            interpolation_gain=None if gain is None else {name: real_or_nan(value) for name, value in gain.items()},
            target=None if record.get("target") is None else Aim.from_json(record["target"]),
            comparison=tuple(map(Candidate.from_json, record.get("comparison") or ())),
            estimate=None if record.get("estimate") is None else Estimate.from_json(record["estimate"]),
            compared_with=str(record.get("compared_with") or "uniform"),
            understood={str(place): str(text) for place, text in (record.get("understood") or {}).items()},
            record=record,
        )

    @property
    def headline(self) -> str:
        """What the mesh is worth, in one sentence."""
        if self.status in FAILED:
            return f"The solve failed: {self.status.replace('_', ' ')}."
        if self.interpolation_gain is None:
            return "The mesh is finished. There is no u, so no error of interpolation is measured."
        l2, h1 = self.interpolation_gain.get("l2", math.nan), self.interpolation_gain.get("h1", math.nan)
        if not (math.isfinite(l2) and l2 > 0.0):
            return "The mesh is finished. How much smaller the error of interpolation is, is not known."
        (here, word), there = _compared(l2), "uniform" if self.compared_with == "uniform" else "initial"
        of_gradient = f"; that of its gradient is {_compared(h1)[0]}" if math.isfinite(h1) and h1 > 0.0 else ""
        return f"The error of interpolating u is {here} {word} on the {there} mesh{of_gradient}."

    @property
    def details(self) -> str:
        """The numbers behind the headline, one on each line, without the warnings."""
        status = self.status.replace("_", " ") + (f", mode {self.mode}" if self.mode else "")
        lines = [f"  status                {status}"]
        lines += [f"  read as               {place} = {text}" for place, text in self.understood.items()]
        lines += [f"  relaxed               {part}" for part in self.relaxed]
        if self.equation_residual is not None:
            residual = _short(self.equation_residual)
            lines.append(f"  equation residual     {residual}  (of squared metric lengths, relative)")
            grid, solved = _error(self.discretization_error), _error(self.algebraic_error)
            lines.append(
                f"  estimated error       {grid}"
                + ("" if grid == solved == UNKNOWN else f" of the grid, {solved} of the solution on it")
            )
        one = "the uniform mesh" if self.compared_with == "uniform" else "a parallelogram of the mean area"
        lines.append(f"  smallest Jacobian     {_short(self.min_jacobian)}  (1 for {one})")
        if math.isfinite(self.non_orthogonality):
            angles = f"{_short(self.non_orthogonality)} degrees, {_short(self.mean_non_orthogonality)} mean"
            lines.append(f"  non-orthogonality     {angles}; skewness {_short(self.skewness)}")
        if self.interpolation_gain is not None:
            gains = ", ".join(f"{_short(value)} in {name.upper()}" for name, value in self.interpolation_gain.items())
            lines.append(
                f"  interpolation gain    {gains}  (error on the {self.compared_with} mesh over that on this one)"
            )
        if self.target is not None:
            lines.append(f"  target                {self.target}")
        lines += [f"  compared              {candidate}" for candidate in self.comparison]
        if self.estimate is not None:
            lines.append(f"  estimate              {self.estimate}  (of the given values, on their own mesh)")
        return "\n".join(lines)

    def table(self) -> str:
        """The certificate in a few lines: the headline first, the warnings last."""
        return "\n".join([self.headline, self.details, *(f"  warning: {warning}" for warning in self.warnings)])

    def __str__(self) -> str:
        return self.table()


def _short(value: float) -> str:
    """A number in two digits."""
    if not math.isfinite(value):
        return UNKNOWN
    return f"{value:.0f}" if 100 <= abs(value) < 1e5 else f"{value:.2g}"


def _error(value: float) -> str:
    return "exact" if value == 0.0 else _short(value)


def _compared(gain: float) -> tuple[str, str]:
    """An error next to one that is ``gain`` times as large, and the word that leads to it."""
    if abs(gain - 1.0) < MIN_DIFFERENCE:
        return "the same", "as"
    ratio, word = (gain, "smaller") if gain > 1.0 else (1.0 / gain, "larger")
    if ratio >= MIN_RATIO:
        return f"{_short(ratio)} times {word}", "than"
    return f"{100.0 * abs(1.0 - 1.0 / gain):.2g} % {word}", "than"
