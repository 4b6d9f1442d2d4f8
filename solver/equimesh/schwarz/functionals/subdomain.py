"""The mesh equations of one subdomain: its window of the grid, its interfaces, and the data that it exchanges."""

from dataclasses import dataclass, replace
from typing import Protocol

from equimesh.equations.boundary import sides
from equimesh.equations.mesh_equations import Condition, MeshEquations
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.conditions import Classical, PairOfFunctionals
from equimesh.schwarz.decomposition import Decomposition, Subdomain
from equimesh.schwarz.functionals.interface import Interface, InterfaceCorner, InterfaceData
from equimesh.schwarz.window import AXES, ENDS, SubdomainWindow


@dataclass(frozen=True, kw_only=True)
class Link:
    """One interface of the subdomain that receives data over it.

    ``axis`` is the direction across it, ``end`` the end of the subdomain where it lies, ``line`` its grid line in the
    whole grid, ``sender`` the number of the neighbour beyond, ``p`` the signed parameter of the ``condition``.
    """

    condition: PairOfFunctionals
    axis: int
    end: int
    line: int
    sender: int
    p: float


@dataclass(frozen=True, kw_only=True)
class CornerLink:
    """The node where two interfaces of a subdomain meet: its place in the whole grid, and the diagonal neighbour."""

    node: tuple[int, int]
    sender: int


class Neighbours(Protocol):
    """The other subdomains, as the receiver reads them."""

    def functional(self, link: Link) -> InterfaceData:
        """The two functionals of the link's condition on its grid line, evaluated by the sender."""
        ...

    def node(self, link: CornerLink) -> tuple[float, float]:
        """The position that the sender gives a node."""
        ...


class SubdomainProblem:
    """The equations of one subdomain that exchanges functionals with its neighbours.

    Its window reaches ``ghosts`` grid lines beyond every interface. The state is a :class:`~equimesh.meshes.mesh.Mesh`
    of the window's shape and belongs to the caller.
    """

    def __init__(
        self, problem: Problem, decomposition: Decomposition, part: Subdomain, condition: PairOfFunctionals
    ) -> None:
        self.problem, self.part, self.condition = problem, part, condition
        self.window = SubdomainWindow(decomposition, part, condition.ghosts)
        self.links = tuple(self._link(decomposition, *side) for side, is_open in self.window.open.items() if is_open)
        self.corner_links = tuple(
            self._corner_link(decomposition, ends)
            for ends in ((0, 0), (0, 1), (1, 0), (1, 1))
            if self.window.open[0, ends[0]] and self.window.open[1, ends[1]]
        )

    def equations(self, neighbours: Neighbours, *, classical: bool = False) -> MeshEquations:
        """The subdomain's equations with data from its neighbours.

        ``classical`` takes the neighbours' positions on the outermost lines of the window instead of the condition: a
        problem that more often has a solution near by.
        """
        conditions = self._conditions(neighbours, classical)
        return MeshEquations(self.problem.metric, self.window.shape, self._spacing, conditions)

    def held(self, neighbours: Neighbours, state: Mesh) -> Mesh:
        """The state with the neighbours' positions on the outermost lines beyond interfaces: classical data."""
        x, y = state.x.copy(), state.y.copy()
        for link in map(self.classical, self.links):
            data, edge, nodes = neighbours.functional(link), -1 if link.end else 0, self._nodes(link.axis)
            place = (edge, nodes) if link.axis == 0 else (nodes, edge)
            across, along = (x, y) if link.axis == 0 else (y, x)
            across[place], along[place] = data.normal, data.tangential
        for corner in self.corner_links:
            local = (corner.node[0] - self.window.first[0], corner.node[1] - self.window.first[1])
            x[local], y[local] = neighbours.node(corner)
        return Mesh(x, y)

    def functional(self, state: Mesh, link: Link) -> InterfaceData:
        """The data that this subdomain sends over a neighbour's ``link``: the functionals of its own window."""
        if isinstance(link.condition, Classical):
            return self._positions(state, link)
        equations = MeshEquations(self.problem.metric, self.window.shape, self._spacing, ())
        window = equations.window(equations.vector(state))
        turned = window if link.axis == 0 else window.turned()
        line, nodes = link.line - self.window.first[link.axis], self._nodes(link.axis)
        return InterfaceData(
            normal=link.condition.normal(turned, line, link.p).values[nodes],
            tangential=link.condition.tangential(turned, line, link.p).values[nodes],
        )

    def node(self, state: Mesh, link: CornerLink) -> tuple[float, float]:
        """Position of a node of the whole grid in this subdomain's window."""
        local = (link.node[0] - self.window.first[0], link.node[1] - self.window.first[1])
        return float(state.x[local]), float(state.y[local])

    def _positions(self, state: Mesh, link: Link) -> InterfaceData:
        line = link.line - self.window.first[link.axis]
        across, along = (state.x, state.y) if link.axis == 0 else (state.y.T, state.x.T)
        nodes = self._nodes(link.axis)
        return InterfaceData(normal=across[line][nodes].copy(), tangential=along[line][nodes].copy())

    @property
    def _spacing(self) -> tuple[float, float]:
        return self.problem.grid.d_xi, self.problem.grid.d_eta

    def _link(self, decomposition: Decomposition, axis: int, end: int) -> Link:
        span, (column, row) = self.part.spans[axis], self.part.place
        step = 1 if end else -1
        sender = decomposition.at(column + step * (axis == 0), row + step * (axis == 1)).number
        line = span.last if end else span.first
        spacing = self._spacing[axis]
        beyond = 1.0 - line * spacing if end else line * spacing
        return Link(
            condition=self.condition,
            axis=axis,
            end=end,
            line=line,
            sender=sender,
            p=step * self.condition.strength(beyond),
        )

    def _corner_link(self, decomposition: Decomposition, ends: tuple[int, int]) -> CornerLink:
        column, row = (place + (1 if end else -1) for place, end in zip(self.part.place, ends, strict=True))
        xi, eta = (self.window.slices[axis].stop - 1 if ends[axis] else self.window.slices[axis].start for axis in AXES)
        return CornerLink(node=(xi, eta), sender=decomposition.at(column, row).number)

    def nodes(self, axis: int) -> int:
        """The number of nodes along an interface across ``axis`` that no other interface of the window holds."""
        nodes = self._nodes(axis)
        return int(nodes.stop - nodes.start)

    def _nodes(self, axis: int) -> slice:
        """Nodes along an interface across ``axis`` that no other interface of the window holds."""
        lower, upper = (int(self.window.open[1 - axis, end]) for end in ENDS)
        return slice(lower, self.window.shape[1 - axis] - upper)

    def _conditions(self, neighbours: Neighbours, classical: bool) -> list[Condition]:
        physical = [side for place, side in sides(self.problem.boundary).items() if not self.window.open[place]]
        corners = []
        for corner in self.corner_links:
            x, y = neighbours.node(corner)
            local = (corner.node[0] - self.window.first[0], corner.node[1] - self.window.first[1])
            corners.append(InterfaceCorner(node=local, x=x, y=y))
        links = [self.classical(link) for link in self.links] if classical else self.links
        return [*physical, *(self._interface(link, neighbours.functional(link)) for link in links), *corners]

    def classical(self, link: Link) -> Link:
        """The outermost line of the window beyond an interface, with the classical condition."""
        window = self.window.slices[link.axis]
        return replace(link, condition=Classical(), line=window.stop - 1 if link.end else window.start, p=0.0)

    def _interface(self, link: Link, data: InterfaceData) -> Interface:
        # Where the interface ends on a physical side or at another interface, the tangential unknown is fixed already.
        return Interface(
            condition=link.condition,
            axis=link.axis,
            end=link.end,
            line=link.line - self.window.first[link.axis],
            nodes=self._nodes(link.axis),
            free=slice(1, self.window.shape[1 - link.axis] - 1),
            p=link.p,
            data=data,
        )
