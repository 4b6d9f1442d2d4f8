"""Grids and node coordinates: geometry only, no monitor and no status."""

from equimesh.meshes.mesh_part import MeshPart, cut
from equimesh.meshes.nested import halved, prolong

__all__ = ["MeshPart", "cut", "halved", "prolong"]
