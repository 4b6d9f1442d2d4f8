"""Quality measures, from JSON to a table."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from equimesh_client import Quality


def test_quality_speaks_and_lacks_nothing_it_was_not_given() -> None:
    errors = {"l2": 1e-4, "l2_uniform": 2e-3, "h1": 1.0, "h1_uniform": 2.0}
    q_eq = {"max": 1.6375, "rms": 1.0, "cells": [[1, 2]]}
    quality = Quality.from_json({"q_eq": q_eq, "min_jacobian": 0.1, "interpolation_error": errors, "new": 3})
    assert quality.q_eq.max == 1.6375
    assert np.isnan(quality.q_eq.min)
    assert quality.q_eq.cells is not None
    assert quality.q_eq.cells.shape == (1, 2)
    with pytest.raises(AttributeError, match="no measure 'q_foo'"):
        _ = quality.q_foo
    assert "1.6375" in str(quality)
    assert "1.000e-04" in str(quality)
    assert str(Quality.from_json({}))
    assert pickle.loads(pickle.dumps(quality)).min_jacobian == 0.1
