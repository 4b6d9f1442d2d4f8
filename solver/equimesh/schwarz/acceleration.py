"""Acceleration of the iteration: none, Anderson's combination, or a Newton step for the fixed point."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.anderson import Anderson
from equimesh.schwarz.holding.port import Holding
from equimesh.schwarz.line_corrections import CorrectionResult
from equimesh.schwarz.port import MergedSolutions, Subdomains
from equimesh.schwarz.raspen import Raspen
from equimesh.schwarz.settings import Acceleration, Schwarz

# Largest deviation of a squared metric length from the mean of its line, as a share of the mean, near the solution.
# Farther away, earlier changes do not predict later ones.
MAX_LINEAR_DEVIATION = 0.1


@dataclass(frozen=True)
class AccelerationResult:
    """A mesh, and whether it is a combination. ``products`` counts products with the derivative of the iteration."""

    mesh: Mesh
    is_combined: bool = False
    products: int = 0


class Accelerator(Protocol):
    """Combines the results of several iterations to one mesh.

    With ``maps_merged_meshes`` the iteration must be a map of merged meshes: all data comes from one merged mesh.
    """

    maps_merged_meshes: bool

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The mesh to continue from, after an iteration that led from ``before`` to the ``corrected`` mesh.

        ``solved`` are its subdomains; errors of at most ``enough`` need no acceleration.
        """
        ...

    def forget(self) -> None:
        """Forget the iterations so far: later ones do not continue them."""
        ...


def accelerator(
    settings: Schwarz, holding: Holding, subdomains: Callable[[], Subdomains], rounding: float, threads: int
) -> Accelerator:
    """The accelerator of the settings; ``subdomains`` returns all of them, for a process that has whole meshes."""
    if settings.accelerated_by is Acceleration.NEWTON:
        return ByNewton(holding, lambda: Raspen(subdomains(), rounding, threads))
    return ByAnderson(holding) if settings.accelerated_by is Acceleration.ANDERSON else Unaccelerated()


class Unaccelerated:
    """No acceleration."""

    maps_merged_meshes = False

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The corrected mesh."""
        del before, solved, enough
        return AccelerationResult(corrected.mesh)

    def forget(self) -> None:
        """Nothing is remembered."""


class ByAnderson:
    """Anderson's combination, near the solution and while it is needed."""

    maps_merged_meshes = False

    def __init__(self, holding: Holding) -> None:
        self._holding = holding
        self._anderson = Anderson(holding)

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The combination, or the corrected mesh where there is none."""
        del solved
        if corrected.estimate <= enough or corrected.deviation > MAX_LINEAR_DEVIATION:
            return AccelerationResult(corrected.mesh)
        combined = self._anderson.combine(before, corrected.mesh)
        return (
            AccelerationResult(corrected.mesh) if combined is None else AccelerationResult(combined, is_combined=True)
        )

    def forget(self) -> None:
        """Forget all iterations."""
        self._anderson = Anderson(self._holding)


class ByNewton:
    """Newton steps for the fixed point, where all subdomains were solved with the requested condition."""

    maps_merged_meshes = True

    def __init__(self, holding: Holding, raspen: Callable[[], Raspen]) -> None:
        self._holding, self._make = holding, raspen

    @cached_property
    def _raspen(self) -> Raspen:
        return self._make()

    def apply(
        self, before: Mesh, corrected: CorrectionResult, solved: MergedSolutions, enough: float
    ) -> AccelerationResult:
        """The mesh after a Newton step, or the corrected mesh where there is none."""
        del enough
        if solved.has_stalled or solved.is_rescued:
            return AccelerationResult(corrected.mesh)
        combined, products = self._holding.on_whole(self._step, [before, corrected.mesh], solved.states)
        if combined is None:
            return AccelerationResult(corrected.mesh, products=int(products))
        return AccelerationResult(combined, is_combined=True, products=int(products))

    def _step(self, meshes: Sequence[Mesh], states: Sequence[Mesh]) -> tuple[Mesh | None, float]:
        """The mesh after a Newton step, and the number of products."""
        combined = self._raspen.combine(meshes[0], meshes[1], states)
        return combined, float(self._raspen.products)

    def forget(self) -> None:
        """Nothing is remembered."""
