"""Anderson acceleration of a fixed-point iteration for meshes."""

from collections import deque

import numpy as np

from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array

# Iterations that are combined with the last one.
MAX_COMBINED = 5
# Singular values below this share of the largest count as zero: nearly equal changes add nothing.
MIN_SINGULAR_SHARE = 1e-12


class Anderson:
    """The combination of the last few results of an iteration whose changes nearly cancel (Anderson, type II)."""

    def __init__(self, depth: int = MAX_COMBINED) -> None:
        self._changes: deque[Array] = deque(maxlen=depth)
        self._results: deque[Array] = deque(maxlen=depth)
        self._last: tuple[Array, Array] | None = None

    def combine(self, start: Mesh, result: Mesh) -> Mesh | None:
        """A mesh nearer to the fixed point than ``result``, the result of one iteration from ``start``.

        ``None`` at the first call, where nothing changed, and where the combination would fold.
        """
        result_now = np.concatenate([result.x.ravel(), result.y.ravel()])
        change = result_now - np.concatenate([start.x.ravel(), start.y.ravel()])
        last, self._last = self._last, (change, result_now)
        if last is None:
            return None
        difference = change - last[0]
        if not np.any(difference):
            return None
        self._changes.append(difference)
        self._results.append(result_now - last[1])
        weights = self._weights(change)
        combined = result_now - sum(w * r for w, r in zip(weights, self._results, strict=True))
        x, y = (half.reshape(result.x.shape) for half in np.split(combined, 2))
        if not smallest_jacobian(x, y) > 0.0:
            return None
        return Mesh(x.copy(), y.copy())

    def _weights(self, change: Array) -> Array:
        """The least-squares weights of the earlier changes, by their normal equations scaled to unit length."""
        size = np.array([float(np.linalg.norm(c)) for c in self._changes])
        gram = np.array([[float(a @ b) for b in self._changes] for a in self._changes]) / np.outer(size, size)
        against = np.array([float(c @ change) for c in self._changes]) / size
        solution = np.linalg.lstsq(gram, against, rcond=MIN_SINGULAR_SHARE)[0]
        return np.asarray(solution / size)
