"""Fields of a step and their settings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from equimesh_client import BadArgument, Field
from equimesh_client.spec.fields import read_fields
from equimesh_coupling import values
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import MeshParts
from equimesh_coupling.values import CellAverages

x, y = np.meshgrid(np.linspace(0, 1, 3), np.linspace(0, 1, 4), indexing="ij")
SIDES = {name: np.array([[0, 1]]) for name in ("left", "right", "bottom", "top")}
POINTS = np.column_stack([x.ravel(), y.ravel()])
MESH = MeshParts(points=POINTS, cells=np.zeros((6, 4), dtype=np.int64), sides=SIDES, shape=(3, 4))


class CellVariable:
    """A field of FiPy, by the names of its types."""

    __module__ = "fipy.variables"


def test_what_solvers_have_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    read: Any = lambda field, mesh: mesh.points[:, 0].reshape(mesh.shape)  # noqa: E731, ARG005
    monkeypatch.setitem(values.READERS, ("fipy", "CellVariable"), read)
    given = {"row": x.ravel(), "theirs": CellVariable(), "cells": CellAverages(np.arange(6.0))}
    arrays, settings = read_fields(given, MESH)
    np.testing.assert_array_equal(arrays["row"], x)
    np.testing.assert_array_equal(arrays["theirs"], x)
    np.testing.assert_array_equal(arrays["cells"], np.arange(6.0).reshape(2, 3))
    assert settings == {"cells": {"transfer": "conservative", "location": "cells"}}
    with pytest.raises(BadValues, match=r"5 values of shape \(5,\), and this mesh has 6 quadrilaterals"):
        read_fields({"cells": CellAverages(np.arange(5.0))}, MESH)


def test_only_unusual_settings_are_said() -> None:
    ones = np.ones((3, 4))
    fields = {
        "a": ones,
        "b": Field(ones),
        "c": Field(ones, location="cells"),
        "d": Field(ones, "spline", bounds=(0, 2)),
    }
    arrays, settings = read_fields(fields, MESH)
    assert [*arrays] == [*fields]
    assert settings == {"c": {"location": "cells"}, "d": {"transfer": "spline", "bounds": [0.0, 2.0]}}
    assert read_fields(None, MESH) == ({}, {})


def test_what_is_no_array_of_numbers() -> None:
    with pytest.raises(BadArgument, match="p is not an array of real numbers"):
        read_fields({"p": "text"}, MESH)
    with pytest.raises(BadArgument, match="p is not an array of real numbers: it is complex"):
        read_fields({"p": 1j * x}, MESH)
    with pytest.raises(BadArgument, match="give them by their names"):
        read_fields([x], MESH)  # type: ignore[arg-type]
