"""Grids and node coordinates: geometry only, no monitor and no status."""

from typing import NoReturn

from equimesh import compiling
from equimesh.meshes.nested import halved, prolong

compiling.watch()  # whoever compiles loops has a mesh

__all__ = ["halved", "prolong"]


def __getattr__(name: str) -> NoReturn:
    if name in ("MeshPart", "cut"):
        raise ImportError(f"equimesh.meshes.{name} is equimesh_cluster.{name} now")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
