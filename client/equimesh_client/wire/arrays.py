"""The arrays of a mesh, from the archive that the service sends."""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from equimesh_client.errors import DownloadDamaged
from equimesh_client.records.tables import Array, IntArray

SIDES = ("left", "right", "bottom", "top")


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshArrays:
    """The mesh itself: ``x``, ``y`` and ``u`` of shape ``(n_xi, n_eta)``, ``u`` None where the monitor has none,
    ``cells`` counter-clockwise, ``(m, 4)``
    or for triangles ``(m, 3)``, ``q_eq`` and ``subdomain`` of the quadrilaterals, ``(n_xi - 1, n_eta - 1)``, which
    two successive triangles share, ``boundary``: edges ``(k, 2)`` of each side, the domain on their left,
    ``fields``: what was carried along with a step of a sequence, of the shape of ``u``.
    """

    x: Array
    y: Array
    u: Array | None
    cells: IntArray
    q_eq: Array
    subdomain: IntArray
    boundary: Mapping[str, IntArray]
    fields: Mapping[str, Array] = field(default_factory=dict)

    @cached_property
    def points(self) -> Array:
        """Node coordinates, shape ``(n_xi * n_eta, 2)``."""
        return np.column_stack([self.x.ravel(), self.y.ravel()])


KNOWN = frozenset({"x", "y", "u", "cells", "q_eq", "subdomain", *SIDES})


def arrays_of(npz: bytes) -> MeshArrays:
    """The arrays of an npz mesh file. Raises :class:`DownloadDamaged` when it is not one."""
    try:
        with np.load(io.BytesIO(npz), allow_pickle=False) as file:
            shape = (file["x"].shape[0] - 1, file["x"].shape[1] - 1)
            every = 2 if file["cells"].shape[1] == 3 else 1
            return MeshArrays(
                x=file["x"],
                y=file["y"],
                u=file.get("u"),
                cells=file["cells"].astype(np.int64),
                q_eq=file["q_eq"].ravel()[::every].reshape(shape),
                subdomain=file["subdomain"].ravel()[::every].reshape(shape).astype(np.int64),
                boundary={side: file[side].astype(np.int64) for side in SIDES},
                fields={name: file[name] for name in file.files if name not in KNOWN},
            )
    except (KeyError, ValueError, OSError, EOFError, IndexError, zipfile.BadZipFile) as error:
        raise DownloadDamaged(f"the npz file of the mesh cannot be read: {error}") from error
