"""One round: from the nodal values of a solver on a mesh to the next mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy.typing as npt

from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.errors import InputError
from equimesh.least_error.elements import Norm
from equimesh.least_error.ways import mesh_of
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.curvature import NORMS
from equimesh.numerics.threads import thread_count
from equimesh.rounds.candidates import Search
from equimesh.rounds.recovery import Recovery, moved_cells

KEPT = "kept"
"""The name of the mesh before, where no candidate is valid or the values are those of a linear function."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Knowledge:
    """What the values of a solver say of the mesh that they are on."""

    recovery: Recovery
    """u, recovered from the values."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, in the units of u times a length."""
    estimate_h1: float
    """The same for the gradient, in the units of u. It must not rank meshes: one without resolution looks good."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""

    @classmethod
    def of(cls, mesh: Mesh, values: npt.ArrayLike, domain: Domain, threads: int = 1) -> Knowledge:
        """From ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``, a mesh of ``domain``.

        Raises :class:`~equimesh.errors.SamplesError` for values of another shape or not finite, and
        :class:`~equimesh.errors.InputError` for a folded mesh.
        """
        known = Recovery.of(mesh, values, domain)
        slopes, size = known.estimate("h1", threads), known.gradient_norm()
        return cls(
            recovery=known,
            estimate=known.estimate("l2", threads),
            estimate_h1=slopes,
            unresolved=slopes / size if size > 0.0 else 0.0,
        )

    @property
    def is_exact(self) -> bool:
        """Whether the estimate is nothing but rounding."""
        return not self.estimate > self.recovery.rounding

    def next_mesh(self, norm: Norm, threads: int = 1) -> NextMesh:
        """The next mesh: the best candidate in ``norm``, or the same mesh where u is interpolated exactly."""
        before = self.recovery.mesh
        search = Search(u=self.recovery.u, domain=self.recovery.domain, before=before, norm=norm, threads=threads)
        found = [] if self.is_exact else list(search.candidates())
        if not found:
            return NextMesh(reference=before, chosen=KEPT, candidates={}, gain=1.0, moved_cells=0.0)
        best = search.finished(min(found, key=lambda one: one.error))
        square = mesh_of(best.mesh, before.grid)
        reference = Mesh.of_unit_square(square.x, square.y)
        return NextMesh(
            reference=reference,
            chosen=best.name,
            candidates={one.name: one.error for one in found},
            gain=search.error_on(before) / best.error if best.error > 0.0 else 1.0,
            moved_cells=moved_cells(before, reference),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMesh:
    """The mesh for the next solve."""

    reference: Mesh
    """It on the reference square."""
    chosen: str
    """The name of the candidate that it was."""
    candidates: Mapping[str, float]
    """The candidates, with the errors of the interpolant of the recovered u on them in the requested norm."""
    gain: float
    """The error of the interpolant of the recovered u in the requested norm, on the mesh before over that on this one.

    Both are measured at the same points of each cell, which are fewer than those of the estimate. Where the values do
    not resolve the solution it can be below 1.
    """
    moved_cells: float
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Round:
    """The next mesh, and what the values say of the mesh that they are on."""

    mesh: Mesh
    """The next mesh of the domain, with as many nodes."""
    reference: Mesh
    """The same mesh on the reference square."""
    estimate: float
    """As :attr:`Knowledge.estimate`, 0 where that is nothing but rounding."""
    estimate_h1: float
    """As :attr:`Knowledge.estimate_h1`."""
    unresolved: float
    """As :attr:`Knowledge.unresolved`."""
    chosen: str
    """As :attr:`NextMesh.chosen`."""
    candidates: Mapping[str, float]
    """As :attr:`NextMesh.candidates`."""
    gain: float
    """As :attr:`NextMesh.gain`."""
    moved_cells: float
    """As :attr:`NextMesh.moved_cells`."""


def adapt_round(
    mesh: Mesh, values: npt.ArrayLike, domain: Domain = UNIT_SQUARE, norm: Norm = "l2", threads: int = 1
) -> Round:
    """The next mesh for a solution that is known by ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``.

    ``mesh`` is one of ``domain``, of any kind. u is recovered from the values as in
    :class:`~equimesh.fields.hermite_field.HermiteField`. The next mesh has the smallest measured error of its
    interpolant, in ``norm``, among descents from ``mesh`` and meshes of straight lines. A pure function: equal
    arguments give an equal mesh bit by bit, for any number of ``threads``. It takes 70 to 120 microseconds of
    processor time a point of a rectangle.

    Raises :class:`~equimesh.errors.SamplesError` for values of another shape or not finite, and
    :class:`~equimesh.errors.InputError` for a folded mesh, another norm or number of threads.
    """
    if norm not in NORMS:
        raise InputError(f"norm = {norm!r}: choose 'l2' or 'h1'", field="norm")
    threads = thread_count(threads)
    known = Knowledge.of(mesh, values, domain, threads)
    found = known.next_mesh(norm, threads)
    return Round(
        mesh=mesh if found.reference is known.recovery.mesh else map_mesh(found.reference, domain),
        reference=found.reference,
        estimate=0.0 if known.is_exact else known.estimate,
        estimate_h1=known.estimate_h1,
        unresolved=known.unresolved,
        chosen=found.chosen,
        candidates=found.candidates,
        gain=found.gain,
        moved_cells=found.moved_cells,
    )
