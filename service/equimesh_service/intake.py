"""What a worker does with samples that come in: read them, and see that a field can be made of them.

Interpolation of scattered samples takes seconds where there are many. A worker can be stopped, and its linear
algebra runs on one thread, which is tens of times faster for the many small systems here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import equimesh
from equimesh.upload import read_samples


def convert(source: Path, filename: str, target: Path, max_bytes: int) -> dict[str, Any]:
    """Read an uploaded file into the canonical npz ``target``; returns what the samples are.

    Raises :class:`~equimesh.errors.SamplesError`.
    """
    found = read_samples(source.read_bytes(), filename, max_bytes=max_bytes)
    on_grid = isinstance(found, equimesh.GridSamples)
    with target.open("wb") as file:
        if isinstance(found, equimesh.GridSamples):
            np.savez(file, x=found.x, y=found.y, values=found.values)
        else:
            np.savez(file, points=found.points, values=found.values)
    return {
        "kind": "grid" if on_grid else "scattered",
        "shape": list(found.values.shape),
        "min": float(found.values.min()),
        "max": float(found.values.max()),
    }


def check_scattered(points: Sequence[Sequence[float]], values: Sequence[float]) -> None:
    """Raise :class:`~equimesh.errors.SamplesError` when no field can be made of scattered samples."""
    equimesh.ScatteredSamples(points=points, values=values)


def load_field(path: Path) -> equimesh.Field:
    """u from stored samples."""
    with np.load(path, allow_pickle=False) as arrays:
        if "points" in arrays:
            return equimesh.ScatteredSamples(points=arrays["points"], values=arrays["values"])
        return equimesh.GridSamples(x=arrays["x"], y=arrays["y"], values=arrays["values"])
