"""Smooth meshes, points of the unit square, and differences of tuples of arrays."""

from __future__ import annotations

import numpy as np

import equimesh as em

ANYWHERE = np.random.default_rng(7).uniform(0.0, 1.0, (2, 500))


def smooth_mesh(n: int, depth: float = 0.08) -> em.Mesh:
    s, t = np.meshgrid(np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, n + 3), indexing="ij")
    bend_x, bend_y = np.sin(2 * np.pi * s) * np.sin(np.pi * t), np.sin(np.pi * s) * np.sin(2 * np.pi * t)
    return em.Mesh(s + depth * bend_x, t + depth * bend_y)


def largest(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> np.ndarray:
    return np.array([np.abs(a - b).max() for a, b in zip(one, other, strict=True)])
