"""Neighbours of a subdomain that all hold their parts of one mesh."""

from __future__ import annotations

from collections.abc import Sequence

import equimesh as em
from equimesh.schwarz.functionals import CornerLink, InterfaceData, Link, SubdomainProblem


class SameMesh:
    """What the subdomains send while their states are parts of ``mesh``; a single one stands for all of them."""

    def __init__(self, parts: Sequence[SubdomainProblem], mesh: em.Mesh) -> None:
        self.parts, self.mesh = parts, mesh

    def functional(self, link: Link) -> InterfaceData:
        part = self._sender(link.sender)
        return part.functional(part.window.restrict(self.mesh), link)

    def node(self, link: CornerLink) -> tuple[float, float]:
        part = self._sender(link.sender)
        return part.node(part.window.restrict(self.mesh), link)

    def _sender(self, number: int) -> SubdomainProblem:
        return self.parts[number if len(self.parts) > 1 else 0]
