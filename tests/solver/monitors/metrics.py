"""Monitors of every kind, points of domains, and metrics as 2 x 2 matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.monitors.monitor import Monitor

STEEP = em.Expression("tanh(30*(x + y/2 - 0.75))")


WAVE = em.Expression("tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))")


UNIT = em.Rectangle()


SECTOR = em.AnnulusSector(center=(1.0, -2.0), radii=(0.5, 1.5), angles=(20.0, 250.0))


def points(domain: em.Domain = UNIT, n: int = 101) -> tuple[np.ndarray, np.ndarray]:
    line = np.linspace(0.0, 1.0, n)
    return domain.map(*np.meshgrid(line, line, indexing="ij"))


def matrices(entries: tuple[np.ndarray, ...]) -> np.ndarray:
    """The triple of arrays as an array of 2 x 2 matrices."""
    m11, m12, m22 = (np.asarray(entry, dtype=float) for entry in entries)
    return np.stack([np.stack([m11, m12], axis=-1), np.stack([m12, m22], axis=-1)], axis=-2)


def triple(angle: float, first: float, second: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The symmetric matrix with these eigenvalues, ``first`` in the direction ``angle``; arrays of one element."""
    c, s = math.cos(angle), math.sin(angle)
    entries = (first * c * c + second * s * s, (first - second) * s * c, first * s * s + second * c * c)
    return tuple(np.array([entry]) for entry in entries)  # type: ignore[return-value]


def monitors() -> dict[str, Monitor]:
    arc = em.ArcLength(u=STEEP, a=0.9, b=0.01)
    return {
        "arc_length": arc,
        "curvature l2": em.Curvature(u=STEEP),
        "curvature h1": em.Curvature(u=STEEP, norm="h1"),
        "isotropic": em.Curvature(u=STEEP, isotropic=True),
        "isotropic h1": em.Curvature(u=STEEP, isotropic=True, norm="h1"),
        "weight": em.Weight(rho=em.Expression("1 + 9*exp(-20*(x - y)**2)"), u=STEEP),
        "tensor": em.Tensor(m11=em.Expression("2 + x**2"), m12=em.Expression("sin(x*y)"), m22=em.Expression("3")),
        "intersection": em.Intersection(monitors=(arc, em.Curvature(u=WAVE))),
        "smoothed": em.Smoothed(monitor=arc, radius=0.04),
        "smoothed intersection": em.Smoothed(
            monitor=em.Intersection(monitors=(em.Smoothed(monitor=arc, radius=0.1), em.Curvature(u=WAVE))), radius=0.02
        ),
    }


every = pytest.mark.parametrize("name", list(monitors()))
