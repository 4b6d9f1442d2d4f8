"""One round on a domain in blocks: from the nodal values of a solver on a mesh to the next mesh."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from equimesh.blocks.blocks import Blocks
from equimesh.least_error.elements import Norm, Rule
from equimesh.least_error.iteration import MORE_SLOPE_POINTS, LeastErrorSolve, Reached
from equimesh.least_error.levels import coarse_level
from equimesh.least_error.steps import Descent
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.least_error import LeastError
from equimesh.rounds.block_recovery import BlockRecovery, measured_on_blocks, moved_lengths
from equimesh.rounds.candidates import MEASURED_POINTS, PARTS, SHARP, SMOOTH
from equimesh.rounds.next_mesh import KEPT, AnyKnowledge, NextMesh

T = TypeVar("T")


class BriefSolve(LeastErrorSolve):
    """A solve with the usual number of steps, also for sharper weights: it only compares them."""

    @property
    def effort(self) -> float:
        """1."""
        return 1.0


WHOLE = "whole"
"""The name of the descent from the initial mesh of the domain."""


class BlockKnowledge(AnyKnowledge[BlockRecovery]):
    """As :class:`~equimesh.rounds.round.Knowledge`, of values on a mesh in blocks."""

    @classmethod
    def of(cls, mesh: QuadMesh, values: npt.ArrayLike, domain: Blocks, threads: int = 1) -> BlockKnowledge:
        """From ``values`` of shape ``(n,)`` at the nodes of ``mesh``, a mesh of ``domain``.

        Raises :class:`~equimesh.errors.SamplesError` for values of another shape or not finite, and
        :class:`~equimesh.errors.InputError` for a folded mesh, and one of another domain.
        """
        return cls.from_recovery(BlockRecovery.of(mesh, values, domain), threads)

    def next_mesh(self, norm: Norm, threads: int = 1) -> NextMesh[QuadMesh]:
        """The next mesh: the best candidate in ``norm``, or the same mesh where u is interpolated exactly.

        Candidates are descents from the initial mesh of the domain, and from the mesh of the values.
        """
        before, u = self.recovery.mesh, self.recovery.u
        rule = Rule(norm=norm, points=MEASURED_POINTS + (MORE_SLOPE_POINTS if norm == "h1" else 0))
        found = {} if self.is_exact else dict(self._candidates(norm, threads))
        errors = {name: measured_on_blocks(u, mesh, rule, threads) for name, mesh in found.items()}
        errors = {name: error for name, error in errors.items() if np.isfinite(error)}
        if not errors:
            return NextMesh(reference=before, chosen=KEPT, candidates={}, gain=1.0, moved_cells=0.0)
        chosen = min(errors, key=lambda name: errors[name])
        least, mesh = errors[chosen], found[chosen]
        return NextMesh(
            reference=mesh,
            chosen=chosen,
            candidates=errors,
            gain=measured_on_blocks(u, before, rule, threads) / least if least > 0.0 else 1.0,
            moved_cells=moved_lengths(before, mesh),
        )

    def _candidates(self, norm: Norm, threads: int) -> Iterator[tuple[str, QuadMesh]]:
        """Meshes that are not folded, by their names, for the better one of two pairs of weights."""
        known, tried = self.recovery, []
        for distortion, smoothness in (SMOOTH, SHARP):
            monitor = LeastError(u=known.u, norm=norm, distortion=distortion, smoothness=smoothness).on(known.domain)
            brief = BriefSolve(monitor=monitor, domain=known.domain, threads=threads)
            reached = _end_of(brief.coarse(coarse_level(brief.levels)))
            tried.append((brief.lifted_error(reached), monitor, reached))
        _, monitor, reached = min(tried, key=lambda one: one[0])
        solve = LeastErrorSolve(monitor=monitor, domain=known.domain, threads=threads)
        is_first = known.mesh.distance(known.domain.mesh) == 0.0
        starts: list[tuple[str, QuadMesh | None, Reached | None]] = [(WHOLE, None, reached)]
        if not is_first:
            starts.append((PARTS, known.mesh, None))
        for name, start, coarse in starts:
            last: Descent | None = None
            for record in solve.steps(start, coarse=coarse):
                last = record
            mesh = coarse.record.mesh if last is None and coarse is not None else None if last is None else last.mesh
            if isinstance(mesh, QuadMesh) and not mesh.is_folded_on(threads):
                yield name, mesh


def _end_of(steps: Generator[object, None, T]) -> T:
    """What a descent returns at its end."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found
