"""How much of a domain the cells of a mesh cut off at its curved sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Chords
from equimesh.domains.domain import Domain, Rectangle, closed_of, cut_off, most_cut_off
from equimesh.meshes.mesh_rows import MeshWindow
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array

ROUNDING = 1e-6
"""What a share may lie above the bound, as a share of it: parameters of a finished mesh are found to rounding."""


@dataclass(frozen=True, kw_only=True)
class CutOff:
    """Areas between the curved sides of a domain and the cells, as shares of the area of the domain.

    What cells leave out, and what they cover beyond the domain, both count.
    """

    share: float
    """The share that the mesh cuts off."""
    initial: float
    """The share that the uniform or the initial mesh cuts off."""

    @property
    def most(self) -> float:
        """What a mesh of least error may have: a quarter of the domain more than the initial mesh, or twice as much."""
        return most_cut_off(self.initial, 1.0)

    @property
    def is_much(self) -> bool:
        """Whether the mesh has more than :attr:`most`, and is refused where the error is to be small."""
        return self.share > self.most * (1.0 + ROUNDING)


def measure_cut_off(domain: Domain, reference: MeshWindow) -> CutOff:
    """The cut-off of a mesh by its nodes on the reference square."""
    if isinstance(domain, Rectangle):
        return CutOff(share=0.0, initial=0.0)
    rows = reference.rows
    uniform = MeshWindow.uniform(rows, len(reference.x))
    here = [_of_window(domain, one) if rows.first < rows.last else 0.0 for one in (reference, uniform)]
    share, initial = rows.summed(np.array(here)) / domain.area
    return CutOff(share=float(share), initial=float(initial))


def _of_window(domain: Domain, reference: MeshWindow) -> float:
    """The area that the own rows cut off; a seam is no side."""
    rows, (closed_xi, closed_eta) = reference.rows, closed_of(domain)
    nodes, lines = np.stack(reference.nodes(rows.first, rows.last)), list[Array]()
    if not closed_eta:
        lines += [nodes[:, :, 0], nodes[:, :, -1]]
    if not closed_xi:
        lines += [nodes[:, 0]] * (rows.first == 0) + [nodes[:, -1]] * (rows.last == rows.cells[0])
    return sum(cut_off(domain, line[:, :-1], line[:, 1:]) for line in lines)


def measure_block_cut_off(domain: Blocks, mesh: QuadMesh) -> CutOff:
    """The cut-off of a mesh of a domain in blocks; its nodes are at the nearest points of their curves."""
    edges = np.concatenate([side for side in domain.mesh.sides.values() if len(side)])
    total = np.zeros(2)
    for number, curve in enumerate(domain.curves):
        slides, first = domain.node_curve == number, domain.node_parameter
        chords = Chords.of(curve, edges, slides, domain.mesh.points.T, first)
        if chords is None:
            continue
        here = first.copy()
        here[slides] = curve.nearest(*mesh.points[slides].T)
        if curve.closed:
            span = curve.ends[1] - curve.ends[0]
            here[slides] -= span * np.round((here - first)[slides] / span)
        total += chords.cut_off(here), chords.cut_off(first)
    share, initial = total / domain.area
    return CutOff(share=float(share), initial=float(initial))
