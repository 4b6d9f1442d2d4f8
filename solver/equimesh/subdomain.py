"""The mesh equations of one subdomain: its window of the grid, its interfaces, and what it sends and receives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.boundary import sides
from equimesh.decomposition import Decomposition, Subdomain
from equimesh.equations import Condition, MeshEquations
from equimesh.mesh import Mesh
from equimesh.problem import Problem
from equimesh.transmission import Classical, Interface, InterfaceCorner, InterfaceData, TransmissionCondition

Array: TypeAlias = npt.NDArray[np.float64]

AXES = (0, 1)
ENDS = (0, 1)


@dataclass(frozen=True, kw_only=True)
class Link:
    """One interface of a subdomain, seen from the subdomain that receives.

    ``axis`` is the direction across it, ``end`` the end of the subdomain where it lies, ``line`` its grid line in the
    whole grid, ``sender`` the number of the neighbour beyond, ``p`` the signed parameter of the ``condition``.
    """

    condition: TransmissionCondition

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
    """The other subdomains, as a receiver sees them."""

    def functional(self, link: Link) -> InterfaceData:
        """The two functionals of the link's condition on its grid line, evaluated by the sender."""
        ...

    def node(self, link: CornerLink) -> tuple[float, float]:
        """The position that the sender gives a node."""
        ...


class SubdomainProblem:
    """The equations of one subdomain, given its neighbours.

    Its window reaches ``ghosts`` grid lines beyond every interface. The state is a :class:`~equimesh.mesh.Mesh` of the
    window's shape and belongs to the caller.
    """

    def __init__(
        self,
        problem: Problem,
        decomposition: Decomposition,
        part: Subdomain,
        condition: TransmissionCondition,
    ) -> None:
        self.problem, self.part, self.condition = problem, part, condition
        self._open = {
            (axis, end): 0 <= part.place[axis] + (1 if end else -1) < decomposition.subdomains[axis]
            for axis in AXES
            for end in ENDS
        }
        ghosts = condition.ghosts
        self.first = tuple(part.spans[axis].first - ghosts * self._open[axis, 0] for axis in AXES)
        last = tuple(part.spans[axis].last + ghosts * self._open[axis, 1] for axis in AXES)
        self.window = tuple(slice(self.first[axis], last[axis] + 1) for axis in AXES)
        self.shape = (last[0] - self.first[0] + 1, last[1] - self.first[1] + 1)
        self.links = tuple(self._link(decomposition, *side) for side, is_open in self._open.items() if is_open)
        self.corner_links = tuple(
            self._corner_link(decomposition, ends)
            for ends in ((0, 0), (0, 1), (1, 0), (1, 1))
            if self._open[0, ends[0]] and self._open[1, ends[1]]
        )

    def restrict(self, mesh: Mesh) -> Mesh:
        """The window's part of a mesh of the whole grid."""
        columns, rows = self.window
        return Mesh(mesh.x[columns, rows].copy(), mesh.y[columns, rows].copy())

    def merge(self, state: Mesh, mesh: Mesh) -> None:
        """Write the nodes that the subdomain owns into a mesh of the whole grid."""
        place = self.part.owned
        local = self._local(place)
        mesh.x[place], mesh.y[place] = state.x[local], state.y[local]

    def distance(self, state: Mesh, mesh: Mesh) -> tuple[float, float]:
        """Largest difference in x and in y to a mesh of the whole grid, on the subdomain without its ghosts."""
        place = (
            slice(self.part.columns.start, self.part.columns.stop),
            slice(self.part.rows.start, self.part.rows.stop),
        )
        local = self._local(place)
        return (
            float(np.abs(state.x[local] - mesh.x[place]).max()),
            float(np.abs(state.y[local] - mesh.y[place]).max()),
        )

    def equations(self, neighbours: Neighbours, *, classical: bool = False) -> MeshEquations:
        """The subdomain's equations with data from its neighbours.

        ``classical`` takes the positions on the outermost lines of the window instead of the own condition: a problem
        with milder data, for when that one has no solution near by.
        """
        return MeshEquations(self.problem.metric, self.shape, self._spacing, self._conditions(neighbours, classical))

    def functional(self, state: Mesh, link: Link) -> InterfaceData:
        """What this subdomain sends over a neighbour's ``link``: the functionals of its own window."""
        equations = MeshEquations(self.problem.metric, self.shape, self._spacing, ())
        window = equations.window(equations.vector(state))
        turned = window if link.axis == 0 else window.turned()
        line, nodes = link.line - self.first[link.axis], self._nodes(link.axis)
        return InterfaceData(
            normal=link.condition.normal(turned, line, link.p).values[nodes],
            tangential=link.condition.tangential(turned, line, link.p).values[nodes],
        )

    def node(self, state: Mesh, link: CornerLink) -> tuple[float, float]:
        """Position of a node of the whole grid in this subdomain's window."""
        local = (link.node[0] - self.first[0], link.node[1] - self.first[1])
        return float(state.x[local]), float(state.y[local])

    @property
    def _spacing(self) -> tuple[float, float]:
        return self.problem.grid.d_xi, self.problem.grid.d_eta

    def _local(self, place: tuple[slice, slice]) -> tuple[slice, slice]:
        xi, eta = (slice(cut.start - first, cut.stop - first) for cut, first in zip(place, self.first, strict=True))
        return xi, eta

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
        xi, eta = (self.window[axis].stop - 1 if ends[axis] else self.window[axis].start for axis in AXES)
        return CornerLink(node=(xi, eta), sender=decomposition.at(column, row).number)

    def _nodes(self, axis: int) -> slice:
        """Nodes along an interface across ``axis`` that no other interface of the window holds."""
        lower, upper = (int(self._open[1 - axis, end]) for end in ENDS)
        return slice(lower, self.shape[1 - axis] - upper)

    def _conditions(self, neighbours: Neighbours, classical: bool) -> list[Condition]:
        physical = [side for place, side in sides(self.problem.boundary).items() if not self._open[place]]
        corners = []
        for corner in self.corner_links:
            x, y = neighbours.node(corner)
            local = (corner.node[0] - self.first[0], corner.node[1] - self.first[1])
            corners.append(InterfaceCorner(node=local, x=x, y=y))
        links = [self._classical(link) for link in self.links] if classical else self.links
        return [*physical, *(self._interface(link, neighbours.functional(link)) for link in links), *corners]

    def _classical(self, link: Link) -> Link:
        """The outermost line of the window beyond an interface, with the classical condition."""
        window = self.window[link.axis]
        return replace(link, condition=Classical(), line=window.stop - 1 if link.end else window.start, p=0.0)

    def _interface(self, link: Link, data: InterfaceData) -> Interface:
        # Where the interface ends on a physical side, or in a corner of interfaces, the tangential unknown is taken.
        return Interface(
            condition=link.condition,
            axis=link.axis,
            end=link.end,
            line=link.line - self.first[link.axis],
            nodes=self._nodes(link.axis),
            free=slice(1, self.shape[1 - link.axis] - 1),
            p=link.p,
            data=data,
        )
