"""The window of the grid that a subdomain is solved on: its own points and the lines beyond its interfaces."""

from equimesh.meshes.folding import largest_difference
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.decomposition import Decomposition, Subdomain
from equimesh.sweeps.sides import Frame

AXES = (0, 1)
ENDS = (0, 1)


class SubdomainWindow:
    """The grid lines of a subdomain and ``ghosts`` more beyond every interface.

    ``open`` tells by (axis, end) which sides are interfaces. ``first`` is the window's lowest grid point, ``slices``
    its place in the grid, ``shape`` its size. A state is a :class:`~equimesh.meshes.mesh.Mesh` of this shape.
    """

    def __init__(self, decomposition: Decomposition, part: Subdomain, ghosts: int) -> None:
        self.part = part
        self.open = {
            (axis, end): 0 <= part.place[axis] + (1 if end else -1) < decomposition.subdomains[axis]
            for axis in AXES
            for end in ENDS
        }
        self.first = tuple(part.spans[axis].first - ghosts * self.open[axis, 0] for axis in AXES)
        last = tuple(part.spans[axis].last + ghosts * self.open[axis, 1] for axis in AXES)
        self.slices = tuple(slice(self.first[axis], last[axis] + 1) for axis in AXES)
        self.shape = (last[0] - self.first[0] + 1, last[1] - self.first[1] + 1)

    @property
    def physical(self) -> tuple[tuple[bool, bool], tuple[bool, bool]]:
        """Which sides lie on the boundary of the domain, by axis and end."""
        xi, eta = ((not self.open[axis, 0], not self.open[axis, 1]) for axis in AXES)
        return xi, eta

    @property
    def covered(self) -> tuple[slice, slice]:
        """The subdomain's own points in the grid, with those of the overlap."""
        columns, rows = self.part.columns, self.part.rows
        return slice(columns.start, columns.stop), slice(rows.start, rows.stop)

    def frame(self, points: tuple[int, int]) -> Frame:
        """The frame of the window in a grid of this many ``points``, with the edges beyond its interfaces."""
        lower = [float(self.part.spans[axis].first) * self.open[axis, 0] for axis in AXES]
        upper = [float(points[axis] - 1 - self.part.spans[axis].last) * self.open[axis, 1] for axis in AXES]
        return Frame(physical=self.physical, beyond=((lower[0], upper[0]), (lower[1], upper[1])))

    def restrict(self, mesh: Mesh) -> Mesh:
        """The window's part of a mesh of the whole grid."""
        columns, rows = self.slices
        return Mesh(mesh.x[columns, rows].copy(), mesh.y[columns, rows].copy())

    def write(self, state: Mesh, mesh: Mesh, place: tuple[slice, slice]) -> None:
        """Write the nodes at a place of the grid into a mesh of the whole grid."""
        local = self.local(place)
        mesh.x[place], mesh.y[place] = state.x[local], state.y[local]

    def distance(self, state: Mesh, mesh: Mesh) -> tuple[float, float]:
        """Largest difference in x and in y to a mesh of the whole grid, on the subdomain without its ghosts."""
        place = self.covered
        local = self.local(place)
        return (
            largest_difference(state.x[local], mesh.x[place]),
            largest_difference(state.y[local], mesh.y[place]),
        )

    def local(self, place: tuple[slice, slice]) -> tuple[slice, slice]:
        """A place of the grid as one of the window."""
        xi, eta = (slice(cut.start - first, cut.stop - first) for cut, first in zip(place, self.first, strict=True))
        return xi, eta
