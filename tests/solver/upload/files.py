"""Samples on a grid and at scattered points as files, and what must come out of them: the samples, or a refusal."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

from equimesh.errors import SamplesError
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.upload.samples import read_samples

X, Y = np.linspace(0, 1, 6), np.array([0.0, 0.1, 0.4, 0.7, 1.0])


TABLE = np.sin(3 * X)[:, None] + Y**2


GRID_POINTS = np.column_stack([a.ravel() for a in np.meshgrid(X, Y, indexing="ij")])


CLOUD = np.concatenate([[[0, 0], [1, 0], [0, 1], [1, 1]], np.random.default_rng(2).random((40, 2))])


CLOUD_U = CLOUD[:, 0] - 2 * CLOUD[:, 1]


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def csv(points: Any, u: Any, *, head: str = "x,y,u\n", separator: str = ",", end: str = "\n") -> bytes:
    rows = (separator.join(map(repr, map(float, (*p, v)))) for p, v in zip(points, np.ravel(u), strict=True))
    return (head + end.join(rows) + end).encode()


def refused(data: bytes, name: str, *words: str, **options: Any) -> SamplesError:
    with pytest.raises(SamplesError) as caught:
        read_samples(data, name, **options)
    for word in words:
        assert word in caught.value.message
    return caught.value


def check_grid(samples: Any, x: Any = X, y: Any = Y, table: Any = TABLE) -> None:
    assert isinstance(samples, GridSamples)
    for found, expected in ((samples.x, x), (samples.y, y), (samples.values, table)):
        np.testing.assert_array_equal(found, expected)


def check_cloud(samples: Any) -> None:
    assert isinstance(samples, ScatteredSamples)
    np.testing.assert_array_equal(samples.points, CLOUD)
    np.testing.assert_array_equal(samples.values, CLOUD_U)
