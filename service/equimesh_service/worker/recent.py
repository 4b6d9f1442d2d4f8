"""The last meshes of sequences, and the functions on them, which stay in the worker that has read or made them.

Both are known by the SHA-256 of their files, so another worker, or a new one, reads the same from the store.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np

import equimesh

# What is kept of each kind, and the most points of one: a function has about 400 bytes for each.
_MOST, MAX_POINTS = 4, 20_000


class Recent:
    """The last objects of one kind, by keys that tell their content."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()  # guards the changes of it: a service checks steps in several threads

    def get(self, key: Hashable, make: Callable[[], Any], require: Callable[[], None]) -> Any:
        """The object of a key, which ``make`` returns where it is not here.

        ``require`` raises FileNotFoundError where its file was deleted: then it is refused here as everywhere.
        """
        found = self._kept.get(key)
        if found is None:
            found = make()
        else:
            require()
        self.keep(key, found)
        return found

    def keep(self, key: Hashable, found: Any) -> None:
        """Keep an object, where it is one of those that a step needs again: a mesh, or a function, on a small grid."""
        # Other functions than those at nodes may be evaluated in another way after some uses.
        if not isinstance(found, equimesh.Mesh | equimesh.NodalField):
            return
        mesh = found.mesh if isinstance(found, equimesh.NodalField) else found
        if not mesh.is_grid or mesh.x.size > MAX_POINTS:
            return
        with self._lock:
            self._kept[key] = found
            self._kept.move_to_end(key)
            while len(self._kept) > _MOST:
                self._kept.popitem(last=False)


MESHES, FUNCTIONS = Recent(), Recent()
"""Those of this process: meshes by the SHA-256 of their files, functions by that of their samples and by their box."""


def as_read(mesh: equimesh.Mesh) -> equimesh.Mesh:
    """A computed grid as it is read from its file."""
    if not mesh.is_grid:
        return mesh
    return equimesh.Mesh(np.array(mesh.x, order="C"), np.array(mesh.y, order="C"), ties=mesh.ties)
