"""Reading meshes back from npz files."""

import os
import zipfile
from pathlib import Path
from typing import Final

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.mesh import SIDES, Mesh
from equimesh.meshes.mesh_data import MeshData

NPZ_ARRAYS: Final = frozenset({"x", "y", "u", "cells", "q_eq", "subdomain", *SIDES})  # others are fields


def load_npz(path: str | os.PathLike[str]) -> MeshData:
    """The mesh that :func:`write_mesh` wrote as npz, bit for bit.

    Triangles are joined to their quadrilaterals again. Raises :class:`~equimesh.errors.InputError` when the
    file is not such an npz.
    """
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in ("x", "y", "cells", "q_eq", "subdomain")}
            u = archive.get("u")
            fields = {name: archive[name] for name in archive.files if name not in NPZ_ARRAYS}
        shape = (arrays["x"].shape[0] - 1, arrays["x"].shape[1] - 1)
        every = 2 if arrays["cells"].shape[1] == 3 else 1
        q_eq, subdomain = (arrays[name].ravel()[::every].reshape(shape) for name in ("q_eq", "subdomain"))
    except (KeyError, ValueError, IndexError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError(f"{Path(path).name} is not a mesh written by equimesh: {error}", field="path") from error
    return MeshData(mesh=Mesh(arrays["x"], arrays["y"]), u=u, q_eq=q_eq, subdomain=subdomain, fields=fields)
