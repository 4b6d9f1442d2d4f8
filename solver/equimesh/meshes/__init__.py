"""Grids and node coordinates: geometry only, no monitor and no status."""

from equimesh.meshes.nested import halved, prolong

__all__ = ["halved", "prolong"]
