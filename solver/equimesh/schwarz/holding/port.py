"""The interface between the Schwarz iteration and its merged mesh, wherever that is held."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, TypeAlias

from equimesh.domains.domain import Domain
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.decomposition import Decomposition, SubdomainWindow

Place: TypeAlias = tuple[slice, slice]
"""A rectangle of grid points."""
Numbers: TypeAlias = Sequence[float]
WholeWork: TypeAlias = Callable[[Sequence[Mesh], Sequence[Mesh]], tuple[Mesh | None, float]]
"""Work on whole meshes and on the solutions of all subdomains; returns a mesh, and a number."""


class Holding(Protocol):
    """The subdomains that this process holds, and the merged mesh on them.

    A merged mesh is a :class:`~equimesh.meshes.mesh.Mesh`. In one process it is that of the whole grid. Where several
    processes share the subdomains, its arrays are the windows of those held here, one after the other: arithmetic on
    them is arithmetic on the nodes, and all else goes through this interface. All processes call the same functions in
    the same order, and get the same numbers.
    """

    decomposition: Decomposition
    numbers: Sequence[int]
    """The numbers of the subdomains that are held here, in their order."""
    is_whole: bool
    """Whether a merged mesh is that of the whole grid."""

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
