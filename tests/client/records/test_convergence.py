"""The history of an iteration, from JSON to a table."""

from __future__ import annotations

import numpy as np

from equimesh_client import Convergence


def test_convergence_speaks() -> None:
    rows = [
        {"iteration": 0, "max_q_eq": 2.0, "change": None, "error": 0.1, "subdomains": []},
        {"iteration": 1, "max_q_eq": 1.5, "change": 1e-6, "subdomains": [{"newton_steps": 4}, {"newton_steps": 3}]},
    ]
    convergence = Convergence.from_json({"iterations": rows, "rate": 0.25, "predicted_rate": None})
    lines = str(convergence).splitlines()
    assert lines[0].split() == ["iteration", "max_q_eq", "change", "error", "newton", "steps"]
    assert lines[3].split() == ["1", "1.5000", "1.000e-06", "-", "4+3"]
    assert lines[-1] == "observed rate 0.2500"
    assert np.isnan(convergence.column("error")[1])
    swept = [{"sweeps": 2, "status": "converged"}] * 4 + [{"sweeps": 2, "status": "stalled"}]
    rows[0]["transmission"] = "classical"
    rows[1] |= {"transmission": "optimized", "accelerated": True, "work": 7, "subdomains": swept}
    convergence = Convergence.from_json({"iterations": rows})
    said = str(convergence).splitlines()
    assert said[0].split()[-2:] == ["sweeps", "remark"]
    assert said[3].endswith("5 x 2  optimized took over, 1 stalled, accelerated")
    assert convergence.column("work")[1] == 7
    assert str(Convergence.from_json({})) == "one domain: no Schwarz iteration"


def test_a_descent_is_told_by_the_last_step_on_each_grid() -> None:
    numbers = {"distortion": 0.1, "min_jacobian": 0.5}
    rows = [
        {"level": 0, "grid": [9, 9], "start": "uniform", "step": 1, "error": 0.5, "gain": 1.5, **numbers},
        {"level": 0, "grid": [9, 9], "start": "uniform", "step": 2, "error": 0.25, "gain": 3.0, **numbers},
        {"level": 1, "grid": [17, 9], "start": "uniform", "step": 0, "error": 0.125, "gain": None, **numbers},
    ]
    convergence = Convergence.from_json({"iterations": [], "descent": rows})
    lines = str(convergence).splitlines()
    assert lines[0].split() == ["grid", "start", "step", "error", "gain", "min_jacobian"]
    assert len(lines) == 4
    assert lines[2].split() == ["9", "x", "9", "uniform", "2", "0.2500", "3.0000", "0.5000"]
    assert lines[3].split() == ["17", "x", "9", "uniform", "0", "0.1250", "-", "0.5000"]
    assert convergence.column("error").tolist() == [0.5, 0.25, 0.125]
    assert np.isnan(convergence.column("gain")[2])
