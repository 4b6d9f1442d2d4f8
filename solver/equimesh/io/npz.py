"""Reading meshes back from npz files."""

import os
import zipfile
from pathlib import Path
from typing import Final

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.mesh import SIDES, Mesh
from equimesh.meshes.mesh_data import MeshData

STEP: Final = "step_json"  # the bytes of the JSON of a step: numbers, which every reader of npz files can read
NPZ_ARRAYS: Final = frozenset({"x", "y", "u", "cells", "q_eq", "subdomain", STEP, *SIDES})  # others are fields


def load_npz(path: str | os.PathLike[str]) -> MeshData:
    """The mesh that :func:`write_mesh` wrote as npz, bit for bit, with its fields at nodes and in cells.

    Triangles are joined to their quadrilaterals again. Raises :class:`~equimesh.errors.InputError` when the
    file is not such an npz.
    """
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in ("x", "y", "cells", "q_eq", "subdomain")}
            u = archive.get("u")
            step = archive[STEP].tobytes().decode() if STEP in archive.files else ""
            others = {name: archive[name] for name in archive.files if name not in NPZ_ARRAYS}
        shape = (arrays["x"].shape[0] - 1, arrays["x"].shape[1] - 1)
        every = 2 if arrays["cells"].shape[1] == 3 else 1
        q_eq, subdomain = (arrays[name].ravel()[::every].reshape(shape) for name in ("q_eq", "subdomain"))
        in_cells = {name: values for name, values in others.items() if values.shape[:2] == shape}
    except (KeyError, ValueError, IndexError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError(f"{Path(path).name} is not a mesh written by equimesh: {error}", field="path") from error
    return MeshData(
        mesh=Mesh(arrays["x"], arrays["y"]),
        u=u,
        q_eq=q_eq,
        subdomain=subdomain,
        fields={name: values for name, values in others.items() if name not in in_cells},
        cell_fields=in_cells,
        step=step,
    )
