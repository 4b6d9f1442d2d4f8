"""Loops, threads and linear algebra, independent of meshes."""
