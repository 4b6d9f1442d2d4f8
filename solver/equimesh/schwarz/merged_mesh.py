"""The merged mesh of all subdomains: what an iteration does with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from equimesh.domains.domain import Domain, map_mesh
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh, smallest_jacobian
from equimesh.numerics.types import Array
from equimesh.schwarz.decomposition import Decomposition, Place, SubdomainWindow
from equimesh.schwarz.line_corrections import LineCorrections, LineSums, WholeLineSums, interfaces

Numbers: TypeAlias = Sequence[float]
WholeWork: TypeAlias = Callable[[Sequence[Mesh], Sequence[Mesh]], tuple[Mesh | None, float]]
"""Work on whole meshes and on the solutions of all subdomains; returns a mesh, and a number."""


class MergedMeshes:
    """Operations on merged meshes, which are meshes of the whole grid, and on the solutions of all subdomains.

    A class of merged meshes that are not meshes of the whole grid has other ones. Arithmetic on their arrays is
    arithmetic on the nodes; everything else goes through these methods. ``states`` are solutions of subdomains here, by
    their numbers or in the order of them.
    """

    is_whole = True
    """Whether a merged mesh is the mesh of the whole grid."""

    def __init__(self, decomposition: Decomposition) -> None:
        self.decomposition = decomposition
        self.numbers: Sequence[int] = range(len(decomposition.parts))
        """The numbers of the subdomains that are here, in their order."""

    def restrict(self, window: SubdomainWindow, mesh: Mesh) -> Mesh:
        """A copy of the part of a merged mesh in the window of a subdomain that is here."""
        return window.restrict(mesh)

    def merge(
        self,
        turn: Sequence[int],
        states: Mapping[int, Mesh],
        windows: Sequence[SubdomainWindow],
        places: Mapping[int, Place],
        reads: Sequence[SubdomainWindow],
        mesh: Mesh,
    ) -> None:
        """Write the nodes at their ``places`` of all subdomains of a turn into a merged mesh, in the order of the turn.

        ``states`` have the shapes of ``windows``. Each subdomain gets the nodes in its window of ``reads``.
        """
        del reads
        for k in turn:
            windows[k].write(states[k], mesh, places[k])

    def close_sides(self, mesh: Mesh) -> None:
        """Put the nodes of the four sides on them exactly."""
        mesh.x[0], mesh.x[-1], mesh.y[:, 0], mesh.y[:, -1] = 0.0, 1.0, 0.0, 1.0

    def every(self, numbers: Mapping[int, Numbers]) -> list[Numbers]:
        """The numbers of all subdomains in their order, from those of the subdomains here."""
        return [numbers[k] for k in self.numbers]

    def mismatch(self, states: Mapping[int, Mesh], windows: Sequence[SubdomainWindow], mesh: Mesh) -> float:
        """The largest difference between a subdomain's solution and the merged mesh."""
        return max(max(window.distance(states[k], mesh)) for k, window in enumerate(windows))

    def distance(self, one: Mesh, other: Mesh) -> float:
        """The largest difference of a coordinate between two merged meshes."""
        return one.distance(other)

    def smallest_jacobian(self, mesh: Mesh, domain: Domain | None = None) -> float:
        """The smallest corner Jacobian of a mesh, or of its image on a domain; not scaled by the spacing."""
        found = mesh if domain is None else map_mesh(mesh, domain)
        return float(smallest_jacobian(found.x, found.y))

    def products(self, pairs: Sequence[tuple[Mesh, Mesh]]) -> Array:
        """The inner products of pairs of moves of a merged mesh, as sums over the nodes that each subdomain owns."""
        owned = [part.owned for part in self.decomposition.parts]
        return np.array([sum(product(a, b, place) for place in owned) for a, b in pairs])

    def on_whole(
        self, work: WholeWork, meshes: Sequence[Mesh], states: Sequence[Mesh] = ()
    ) -> tuple[Mesh | None, float]:
        """The result of ``work``, which needs meshes of the whole grid and the solutions of all subdomains."""
        return work(meshes, states)

    def shown(self, mesh: Mesh) -> Mesh | None:
        """The mesh of the whole grid for a record; ``None`` where there is none."""
        return mesh

    def deliver(self, sender: int, to: int, data: Callable[[], Sequence[Array]], kind: str) -> Sequence[Array] | None:
        """The data from one subdomain to another, where the latter is here; ``data`` is called where the former is."""
        del sender, to, kind
        return data()

    def line_sums(
        self, problem: Problem, windows: Sequence[SubdomainWindow], threads: int, *, local: bool = False
    ) -> LineSums:
        """The sums along lines that subdomains of these windows read; ``local``: they read those of sides alone."""
        del windows, local
        return WholeLineSums(problem, interfaces(self.decomposition), threads)

    def line_corrections(self, problem: Problem, threads: int) -> LineCorrections:
        """Corrections of all lines of a merged mesh."""
        return LineCorrections(problem, threads)


def product(one: Mesh, other: Mesh, place: Place) -> float:
    """The inner product of the moves of the nodes at a place."""
    return float(np.vdot(one.x[place], other.x[place]) + np.vdot(one.y[place], other.y[place]))
