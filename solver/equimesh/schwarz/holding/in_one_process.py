"""All subdomains and the whole merged mesh in one process."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from equimesh.domains.domain import Domain, map_mesh
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.decomposition import Decomposition, SubdomainWindow
from equimesh.schwarz.holding.port import Numbers, Place, WholeWork


class InOneProcess:
    """All subdomains are held here, and nothing is sent; see :class:`~equimesh.schwarz.holding.port.Holding`."""

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
