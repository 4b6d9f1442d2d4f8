"""Mesh files of meshes in parts: one file for every part, and a head that ties them together."""
