"""Samples of known functions, the points at which fields are compared with them, and the error that refuses samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from equimesh.errors import InputError, SamplesError
from equimesh.fields.samples import GridSamples

PROBE = np.meshgrid(np.linspace(0, 1, 211), np.linspace(0, 1, 211), indexing="ij")


FINE = np.meshgrid(np.linspace(0, 1, 2501), np.linspace(0, 1, 81), indexing="ij")  # resolves the layer's error


CORNERS = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])


def paper(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The paper's u and its gradient."""
    layer = np.exp(15 * (x - 1))
    return ((1 - layer) * np.sin(np.pi * y), -15 * layer * np.sin(np.pi * y), (1 - layer) * np.pi * np.cos(np.pi * y))


def on_grid(n_x: int, n_y: int, u: Any = paper) -> GridSamples:
    x, y = np.linspace(0, 1, n_x), np.linspace(0, 1, n_y)
    return GridSamples(x=x, y=y, values=u(*np.meshgrid(x, y, indexing="ij"))[0])


def errors(field: Any) -> np.ndarray:
    """Largest error of the value and of the gradient, and the mean-square error of the value."""
    u, u_x, u_y = (found - exact for found, exact in zip(field.evaluate(*FINE, 1), paper(*FINE), strict=True))
    return np.array([np.abs(u).max(), np.hypot(u_x, u_y).max(), np.sqrt(np.mean(u**2))])


def refusal(kind: type, **arrays: Any) -> SamplesError:
    with pytest.raises(SamplesError) as caught:
        kind(**arrays)
    assert isinstance(caught.value, InputError)
    return caught.value


def scattered_points(n: int) -> np.ndarray:
    """n random points inside, and about sqrt(n) on each side, corners included."""
    t = np.linspace(0, 1, max(2, int(np.sqrt(n))))
    zero, one = np.zeros_like(t), np.ones_like(t)
    rim = np.concatenate([np.column_stack(p) for p in ((t, zero), (t, one), (zero, t), (one, t))])
    return np.unique(np.concatenate([np.random.default_rng(7).random((n, 2)), rim]), axis=0)


BOX = ((10.0, 14.0), (-2.0, -1.0))  # of samples that do not lie on the unit square


def on_box(x: Any, y: Any) -> Any:
    """A smooth function on :data:`BOX`."""
    return np.sin(x) * np.exp(y)
