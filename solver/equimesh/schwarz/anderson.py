"""Anderson acceleration of a fixed-point iteration for meshes."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.schwarz.holding.port import Holding

# Iterations that are combined with the last one.
MAX_COMBINED = 5
# Singular values below this share of the largest count as zero: nearly equal changes add nothing.
MIN_SINGULAR_SHARE = 1e-12


class Anderson:
    """The combination of the last few results of an iteration whose changes nearly cancel (Anderson, type II)."""

    def __init__(self, holding: Holding, depth: int = MAX_COMBINED) -> None:
        self._holding, self._depth = holding, depth
        self._changes: deque[Mesh] = deque(maxlen=depth)
        self._results: deque[Mesh] = deque(maxlen=depth)
        self._last: tuple[Mesh, Mesh] | None = None

    def combine(self, start: Mesh, result: Mesh) -> Mesh | None:
        """A mesh nearer to the fixed point than ``result``, the result of one iteration from ``start``.

        ``None`` at the first call, where nothing changed, and where the combination would fold.
        """
        change = _minus(result, start)
        last, self._last = self._last, (change, result)
        if last is None:
            return None
        changes = [*self._changes, _minus(change, last[0])][-self._depth :]
        products = self._products(changes, change)
        if products is None:
            return None
        self._changes.append(changes[-1])
        self._results.append(_minus(result, last[1]))
        x, y = result.x.copy(), result.y.copy()
        for weight, moved in zip(_weights(*products), self._results, strict=True):
            x -= weight * moved.x
            y -= weight * moved.y
        combined = Mesh(x, y)
        return combined if self._holding.smallest_jacobian(combined) > 0.0 else None

    def _products(self, changes: Sequence[Mesh], change: Mesh) -> tuple[Array, Array] | None:
        """The inner products of the earlier changes with each other, and with the last one; ``None`` if one is zero."""
        count = len(changes)
        pairs = [(a, b) for a in changes for b in changes] + [(a, change) for a in changes]
        found = self._holding.products(pairs)
        return (found[:-count].reshape(count, count), found[-count:]) if found[-count - 1] > 0.0 else None


def _minus(one: Mesh, other: Mesh) -> Mesh:
    return Mesh(one.x - other.x, one.y - other.y)


def _weights(products: Array, against: Array) -> Array:
    """The least-squares weights of the earlier changes, by their normal equations scaled to unit length."""
    size = np.sqrt(np.diag(products))
    solution = np.linalg.lstsq(products / np.outer(size, size), against / size, rcond=MIN_SINGULAR_SHARE)[0]
    return np.asarray(solution / size)
