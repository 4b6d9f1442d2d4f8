"""The conservative transfer of values at nodes."""

import numpy as np

from equimesh.numerics.types import Array
from equimesh.transfers.integrals import total
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.repair import giving_of, repair, share_out
from equimesh.transfers.slopes import slopes_of_nodes


def transfer_nodal(overlaps: Overlaps, values: Array, interpolated: Array) -> Array:
    """Values at the old nodes as values at the new ones, in the shape of the nodes, with the same integral.

    The integral is that of the bilinear function, the sum of the values times the weights of
    :meth:`~equimesh.transfers.integrals.Cells.node_weights`; the consistent and the lumped mass matrix of bilinear
    elements have the same one.

    The integral over each new cell is known: from that over each old cell, and the mean slope there, over the common
    parts of both. ``interpolated`` are values of high order at the new nodes. What they lack of the integral of a cell
    goes to its four nodes, in proportion to their weights. Each value lies between the least and the largest value of
    the old cells that meet the new cells around it; what is beyond is given to neighbours, see
    :func:`~equimesh.transfers.repair.repair`. Values on a mesh that does not change stay as they are.
    """
    old, new = overlaps.old, overlaps.new
    of_corners = old.at_corners(values)
    means = np.sum(old.weights * of_corners, axis=1) / old.area
    integrals = overlaps.integrals(means, slopes_of_nodes(old, of_corners, means))
    low, high = overlaps.bounds(of_corners.min(axis=1), of_corners.max(axis=1))
    lowest, highest = new.around_nodes(low, np.minimum), new.around_nodes(high, np.maximum)
    moved = np.clip(interpolated, lowest, highest)
    lacking = integrals - np.sum(new.weights * new.at_corners(moved), axis=1)
    weights = new.node_weights.reshape(new.nodes)
    moved += new.at_nodes(new.weights * (lacking / new.area)[:, None]).reshape(new.nodes) / weights
    repair(moved, weights, lowest, highest, giving_of(new))
    share_out(moved, weights, lowest, highest, total(old.node_weights, values.reshape(-1)))
    return moved
