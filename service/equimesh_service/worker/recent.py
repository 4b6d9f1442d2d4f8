"""The last meshes of sequences, and the functions on them, which stay in the worker that has read or made them.

Both are known by the SHA-256 of their files, so another worker, or a new one, reads the same from the store.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import equimesh
from equimesh.numerics.types import Array
from equimesh_service.assembly.bodies import StepField

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


@dataclass(frozen=True, kw_only=True)
class KnownStep:
    """What the worker that has checked a step need not read: the mesh that the step follows, and the fields on it.

    ``values`` are those of functions at its nodes, by the SHA-256 of their files.
    """

    mesh: equimesh.Mesh
    fields: Mapping[str, StepField]
    values: Mapping[str, Array]

    def function(self, sha256: str) -> equimesh.NodalField | None:
        """The function at the nodes of the mesh; None for another file, and on blocks."""
        values = self.values.get(sha256)
        if values is None or not self.mesh.is_grid:
            return None
        nodes = equimesh.Mesh(self.mesh.x, self.mesh.y) if len(self.mesh.ties) else self.mesh
        return equimesh.NodalField(mesh=nodes, values=_own(values))

    def own_fields(self) -> dict[str, StepField]:
        """The fields as they are read from their file."""
        return {name: replace(field, values=_own(field.values)) for name, field in self.fields.items()}


def _own(values: Array) -> Array:
    # Arrays of a request cannot be written to, and loops would be compiled again for them.
    return np.array(values, dtype=float, order="C")


MESHES, FUNCTIONS = Recent(), Recent()
"""Those of this process: meshes by the SHA-256 of their files, functions by that of their samples and by their box."""


def as_read(mesh: equimesh.Mesh) -> equimesh.Mesh:
    """A computed grid as it is read from its file."""
    if not mesh.is_grid:
        return mesh
    return equimesh.Mesh(np.array(mesh.x, order="C"), np.array(mesh.y, order="C"), ties=mesh.ties)
