"""Mesh files: writing them in every format, and reading npz back."""

from typing import TYPE_CHECKING, Any

from equimesh_coupling.errors import deferred

if TYPE_CHECKING:
    from equimesh.io.npz import load_npz
    from equimesh.io.write import CELLS, FORMATS, Cells, MeshFormat, write_mesh
    from equimesh.meshes.mesh_data import MeshData

__all__ = ["CELLS", "FORMATS", "Cells", "MeshData", "MeshFormat", "load_npz", "write_mesh"]

_MOVED = {
    "PARTED_FORMATS", "PartData", "PartedFormat", "PartedMesh", "read_parts", "remove_parted", "write_head",
    "write_part",
}  # fmt: skip


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name in _MOVED:
            raise ImportError(f"equimesh.io.{name} is equimesh_cluster.{name} now")
        return deferred(__name__, name)
