"""What the subdomains send each other over their interfaces, with the paper's conditions."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.functionals.interface import InterfaceData
from equimesh.schwarz.functionals.subdomain import CornerLink, Link, SubdomainProblem
from equimesh.schwarz.holding.port import Holding


class Exchange:
    """The data that the subdomains which are held here receive: the states of their neighbours, as they read them.

    Where all subdomains are in one process, data is computed when it is read. Else :meth:`read` sends and receives all
    of it, with classical data that may take the place of the condition where it ``has_substitute``.
    """

    def __init__(self, holding: Holding, parts: Sequence[SubdomainProblem], *, has_substitute: bool) -> None:
        self._holding, self._parts, self._has_substitute = holding, parts, has_substitute
        self._states: Mapping[int, Mesh] = {}
        self._received: dict[Link | CornerLink, Sequence[Array]] = {}

    def read(self, states: Mapping[int, Mesh], turn: Sequence[int] | None) -> None:
        """Take ``states`` for those of the subdomains that are held here, and send what those of a ``turn`` need."""
        self._states, self._received = states, {}
        if self._holding.is_whole:
            return
        for k in range(len(self._parts)) if turn is None else turn:
            part = self._parts[k]
            substitutes = [part.classical(link) for link in part.links] if self._has_substitute else []
            links: list[Link | CornerLink] = [*part.links, *substitutes, *part.corner_links]
            for link in links:
                data = self._holding.deliver(link.sender, k, partial(self._sent, link), "interfaces")
                if data is not None:
                    self._received[link] = data

    def functional(self, link: Link) -> InterfaceData:
        """The two functionals of the link's condition on its grid line, evaluated by the sender."""
        normal, tangential = self._received[link] if link in self._received else self._sent(link)
        return InterfaceData(normal=normal, tangential=tangential)

    def node(self, link: CornerLink) -> tuple[float, float]:
        """The position that the sender gives a node."""
        position = (self._received[link] if link in self._received else self._sent(link))[0]
        return float(position[0]), float(position[1])

    def _sent(self, link: Link | CornerLink) -> Sequence[Array]:
        part, state = self._parts[link.sender], self._states[link.sender]
        if isinstance(link, CornerLink):
            return [np.array(part.node(state, link))]
        data = part.functional(state, link)
        return [data.normal, data.tangential]
