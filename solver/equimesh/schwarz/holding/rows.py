"""The rows of a merged mesh: windows become strips of rows, one for each part, at the end of an iteration."""

import numpy as np

from equimesh.meshes.held_mesh import HeldMesh
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import with_halos
from equimesh.schwarz.holding.on_channel import OnChannel
from equimesh.schwarz.holding.places import common, moved


def cuts_of_rows(holding: OnChannel) -> list[int]:
    """The first row of every part, and the number of rows: of strips those that their part owns, else near equal."""
    n_xi, count = holding.decomposition.grid.n_xi, holding.channel.count
    if holding.decomposition.subdomains[1] > 1:
        return [n_xi * part // count for part in range(count + 1)]
    firsts = [holding.decomposition.parts[holding.held_by(part)[0]].spans[0].owned_first for part in range(count)]
    return [*firsts, n_xi]


def rows_of(holding: OnChannel, mesh: Mesh) -> HeldMesh:
    """The rows of this part of a merged mesh, and one more each way."""
    grid, cuts = holding.decomposition.grid, cuts_of_rows(holding)
    spans = with_halos(cuts)
    begin, end = spans[holding.channel.number]
    x, y = np.empty((2, end - begin, grid.n_eta))
    for k, window in enumerate(holding.patches):
        state = holding.view(mesh, k) if k in holding.numbers else None
        for part, span in enumerate(spans):
            place = common(window.part.owned, (slice(*span), slice(0, grid.n_eta)))
            if place is None:
                continue
            nodes = holding.move(holding.holder_of(k), part, holding.cut_from(state, window, place), "rows")
            if nodes is not None:
                local = moved(place, (begin, 0))
                x[local], y[local] = nodes
    return HeldMesh(grid, begin, x, y)
