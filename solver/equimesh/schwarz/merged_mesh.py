"""The merged mesh of all subdomains: its interface, places of its nodes, and the mesh of one process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, TypeAlias

import numpy as np

from equimesh.domains.domain import Domain, map_mesh
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh, smallest_jacobian
from equimesh.numerics.types import Array
from equimesh.schwarz.decomposition import AXES, ENDS, Decomposition, SubdomainWindow
from equimesh.sweeps.sweep import Correction

# The interface between the Schwarz iteration and its merged mesh, wherever that is held.

Place: TypeAlias = tuple[slice, slice]
"""A rectangle of grid points."""
Numbers: TypeAlias = Sequence[float]
WholeWork: TypeAlias = Callable[[Sequence[Mesh], Sequence[Mesh]], tuple[Mesh | None, float]]
"""Work on whole meshes and on the solutions of all subdomains; returns a mesh, and a number."""


class LineSweep(Protocol):
    """Corrections of all lines of a mesh, as :class:`~equimesh.sweeps.sweep.Sweep` has them."""

    def correct(self, x: Array, y: Array) -> Correction:
        """One correction of the nodes ``x``, ``y``."""
        ...

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes."""
        ...

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        ...


class Holding(Protocol):
    """The subdomains that this process holds, and the merged mesh on them.

    A merged mesh is a :class:`~equimesh.meshes.mesh.Mesh`. In one process it is the mesh of the whole grid. Where
    several processes share the subdomains, its arrays are the windows of the subdomains held here, one after the other.
    Arithmetic on them is arithmetic on the nodes; everything else goes through this interface. All processes call the
    same functions in the same order, and get the same numbers.
    """

    decomposition: Decomposition
    numbers: Sequence[int]
    """The numbers of the subdomains that are held here, in their order."""
    is_whole: bool
    """Whether a merged mesh is the mesh of the whole grid."""

    def restrict(self, window: SubdomainWindow, mesh: Mesh) -> Mesh:
        """A copy of the part of a merged mesh in the window of a subdomain that is held here."""
        ...

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

        ``states`` are the solutions of those held here, of the shapes of ``windows``. Each subdomain gets the nodes in
        its window of ``reads``.
        """
        ...

    def close_sides(self, mesh: Mesh) -> None:
        """Put the nodes of the four sides on them exactly."""
        ...

    def every(self, numbers: Mapping[int, Numbers]) -> list[Numbers]:
        """The numbers of all subdomains in their order, from those of the subdomains that are held here."""
        ...

    def mismatch(self, states: Mapping[int, Mesh], windows: Sequence[SubdomainWindow], mesh: Mesh) -> float:
        """The largest difference between a subdomain's solution and the merged mesh."""
        ...

    def distance(self, one: Mesh, other: Mesh) -> float:
        """The largest difference of a coordinate between two merged meshes."""
        ...

    def smallest_jacobian(self, mesh: Mesh, domain: Domain | None = None) -> float:
        """The smallest corner Jacobian of a merged mesh, or of its image on a domain; not scaled by the spacing."""
        ...

    def products(self, pairs: Sequence[tuple[Mesh, Mesh]]) -> Array:
        """The inner products of pairs of moves of a merged mesh, as sums over the nodes that each subdomain owns."""
        ...

    def on_whole(
        self, work: WholeWork, meshes: Sequence[Mesh], states: Sequence[Mesh] = ()
    ) -> tuple[Mesh | None, float]:
        """The result of ``work``, which needs whole meshes: one process does it, and all get their parts of the result.

        ``states`` are the solutions of the subdomains that are held here.
        """
        ...

    def shown(self, mesh: Mesh) -> Mesh | None:
        """The mesh of the whole grid for a record; ``None`` where it stays in its windows."""
        ...

    def along_lines(
        self, axis: int, end: int, first: Callable[[int], Array], on: Callable[[int, Array], Array], kind: str
    ) -> dict[int, Array]:
        """The data that arrive over the interface at one ``end`` of every subdomain that is held here, along ``axis``.

        The subdomains at that end of the grid receive ``first`` of their number. Every other one receives what its
        neighbour there passes ``on``, by its number and what it has received.
        """
        ...

    def deliver(self, sender: int, to: int, data: Callable[[], Sequence[Array]], kind: str) -> Sequence[Array] | None:
        """The data from one subdomain to another: at the receiver, else ``None``. ``data`` is called at the sender."""
        ...

    def line_sweep(self, problem: Problem) -> LineSweep | None:
        """Corrections of all lines of a merged mesh in windows; ``None`` for the mesh of the whole grid."""
        ...


# Rectangles of grid points: what two of them share, and the lines around a subdomain.


def common(one: Place, other: tuple[slice, ...]) -> Place | None:
    """The rectangle that two share; ``None`` where they share no point."""
    xi, eta = (slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return (xi, eta) if xi.start < xi.stop and eta.start < eta.stop else None


def points(place: Place | None) -> int:
    """The number of grid points of a rectangle."""
    return 0 if place is None else (place[0].stop - place[0].start) * (place[1].stop - place[1].start)


def moved(place: tuple[slice, ...], first: tuple[int, ...]) -> Place:
    """A rectangle of the grid as one of a window that begins at the grid point ``first``."""
    xi, eta = (slice(cut.start - start, cut.stop - start) for cut, start in zip(place, first, strict=True))
    return xi, eta


def rim(window: SubdomainWindow) -> dict[tuple[int, int], Place]:
    """The grid points of a window beyond its interfaces, by the step to the neighbour that covers them."""
    cuts = []
    for axis in AXES:
        covered = window.covered[axis]
        here = {0: covered}
        for end in ENDS:
            if window.open[axis, end]:
                beyond = slice(covered.stop, covered.stop + 1) if end else slice(covered.start - 1, covered.start)
                here[1 if end else -1] = beyond
        cuts.append(here)
    return {(i, j): (cuts[0][i], cuts[1][j]) for i in cuts[0] for j in cuts[1] if (i, j) != (0, 0)}


class InOneProcess:
    """All subdomains are held here, and nothing is sent; see :class:`~equimesh.schwarz.merged_mesh.Holding`."""

    is_whole = True

    def __init__(self, decomposition: Decomposition) -> None:
        self.decomposition = decomposition
        self.numbers: Sequence[int] = range(len(decomposition.parts))

    def restrict(self, window: SubdomainWindow, mesh: Mesh) -> Mesh:
        """The window's part of the mesh."""
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
        """Write the nodes of all subdomains of a turn into the mesh."""
        del reads
        for k in turn:
            windows[k].write(states[k], mesh, places[k])

    def close_sides(self, mesh: Mesh) -> None:
        """Put the nodes of the four sides on them exactly."""
        mesh.x[0], mesh.x[-1], mesh.y[:, 0], mesh.y[:, -1] = 0.0, 1.0, 0.0, 1.0

    def every(self, numbers: Mapping[int, Numbers]) -> list[Numbers]:
        """The numbers in the order of the subdomains."""
        return [numbers[k] for k in self.numbers]

    def mismatch(self, states: Mapping[int, Mesh], windows: Sequence[SubdomainWindow], mesh: Mesh) -> float:
        """The largest difference between a subdomain's solution and the mesh."""
        return max(max(window.distance(states[k], mesh)) for k, window in enumerate(windows))

    def distance(self, one: Mesh, other: Mesh) -> float:
        """The largest difference of a coordinate."""
        return one.distance(other)

    def smallest_jacobian(self, mesh: Mesh, domain: Domain | None = None) -> float:
        """The smallest corner Jacobian, not scaled by the spacing."""
        found = mesh if domain is None else map_mesh(mesh, domain)
        return float(smallest_jacobian(found.x, found.y))

    def products(self, pairs: Sequence[tuple[Mesh, Mesh]]) -> Array:
        """The inner products, subdomain by subdomain."""
        owned = [part.owned for part in self.decomposition.parts]
        return np.array([sum(product(a, b, place) for place in owned) for a, b in pairs])

    def on_whole(
        self, work: WholeWork, meshes: Sequence[Mesh], states: Sequence[Mesh] = ()
    ) -> tuple[Mesh | None, float]:
        """The result of the work."""
        return work(meshes, states)

    def shown(self, mesh: Mesh) -> Mesh | None:
        """The mesh itself."""
        return mesh

    def along_lines(
        self, axis: int, end: int, first: Callable[[int], Array], on: Callable[[int, Array], Array], kind: str
    ) -> dict[int, Array]:
        """The data that arrive over the interface at one end of every subdomain."""
        del kind
        found: dict[int, Array] = {}
        for before, k in chain(self.decomposition, axis, end):
            found[k] = first(k) if before is None else on(before, found[before])
        return found

    def deliver(self, sender: int, to: int, data: Callable[[], Sequence[Array]], kind: str) -> Sequence[Array] | None:
        """The traffic."""
        del sender, to, kind
        return data()

    def line_sweep(self, problem: Problem) -> None:
        """Always ``None``: the mesh is the mesh of the whole grid."""


def product(one: Mesh, other: Mesh, place: Place) -> float:
    """The inner product of the moves of the nodes at a place."""
    return float(np.vdot(one.x[place], other.x[place]) + np.vdot(one.y[place], other.y[place]))


def chain(decomposition: Decomposition, axis: int, end: int) -> list[tuple[int | None, int]]:
    """All subdomains from one ``end`` of an axis on, each with its neighbour nearer to that end, if there is one."""
    columns, rows = decomposition.subdomains
    counts, step = (columns, rows), -1 if end else 1
    along = range(counts[axis])[::step]
    found: list[tuple[int | None, int]] = []
    for k in along:
        for other in range(counts[1 - axis]):
            place = (k, other) if axis == 0 else (other, k)
            near = (k - step, other) if axis == 0 else (other, k - step)
            before = None if k == along[0] else decomposition.at(*near).number
            found.append((before, decomposition.at(*place).number))
    return found
