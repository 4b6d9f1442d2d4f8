"""Fields of a step and their settings."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh_client import BadArgument, Field
from equimesh_client.spec.fields import read_fields


def test_only_unusual_settings_are_said() -> None:
    values = np.ones((3, 4))
    fields = {
        "a": values,
        "b": Field(values),
        "c": Field(values, location="cells"),
        "d": Field(values, "spline", bounds=(0, 2)),
    }
    arrays, settings = read_fields(fields)
    assert [*arrays] == [*fields]
    assert settings == {"c": {"location": "cells"}, "d": {"transfer": "spline", "bounds": [0.0, 2.0]}}
    assert read_fields(None) == ({}, {})


def test_what_is_no_array_of_numbers() -> None:
    with pytest.raises(BadArgument, match="p is not an array of real numbers"):
        read_fields({"p": "text"})
