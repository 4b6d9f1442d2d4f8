"""The record of a step, as plain numbers."""

from __future__ import annotations

import json
import math

import equimesh as em
from equimesh.least_error.descent import Descent


def test_a_record_is_plain_numbers_without_its_mesh() -> None:
    grid = em.Grid(n_xi=5, n_eta=4)
    record = Descent(
        level=1,
        levels=3,
        grid=grid,
        step=2,
        steps=8,
        error=0.25,
        gain=math.inf,
        distortion=0.5,
        min_jacobian=math.nan,
        mesh=em.Mesh.uniform(grid),
        start="uniform",
    )
    assert json.loads(json.dumps(record.numbers())) == {
        "level": 1,
        "grid": [5, 4],
        "start": "uniform",
        "step": 2,
        "error": 0.25,
        "gain": None,
        "distortion": 0.5,
        "min_jacobian": None,
    }
