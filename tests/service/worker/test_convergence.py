"""The history of a convergence."""

from __future__ import annotations

import csv

import httpx

from equimesh_service.worker.summary import DescentHistory
from service.requests import WAIT


def test_a_fallback_is_told(http: httpx.Client) -> None:
    spec = {
        "monitor": {"kind": "arc_length", "u": {"expression": "tanh(20*((x-0.5)**2 + (y-0.5)**2 - 0.09))"}},
        "grid": {"n_xi": 33, "n_eta": 33},
        "schwarz": {"transmission": {"kind": "linear_robin"}, "ordering": "alternating"},
    }
    mesh = http.post("/v1/meshes", json=spec, headers=WAIT)
    said = mesh.json()["convergence"]
    assert (said["status"], said["transmission"]) == ("converged", "optimized")
    assert "The linear_robin condition stalled; from iteration" in said["message"]
    history = http.get(mesh.json()["links"]["convergence"]).json()["iterations"]
    assert [record["transmission"] for record in (history[0], history[-1])] == ["linear_robin", "optimized"]
    assert said["work"] == sum(record["work"] for record in history) > 33 * 33
    assert said["traffic"] == sum(record["traffic"] for record in history) > 0


def test_a_descent_is_told_in_json_in_csv_and_as_a_picture(http: httpx.Client) -> None:
    spec = {"monitor": {"kind": "least_error", "u": "tanh(20*(x - y))"}, "grid": {"n_xi": 17, "n_eta": 33}}
    mesh = http.post("/v1/meshes", json=spec, headers=WAIT).json()
    assert (mesh["status"], mesh["convergence"]["status"]) == ("succeeded", "completed")
    url = mesh["links"]["convergence"]
    history = http.get(url).json()
    assert history["iterations"] == []
    steps = [DescentHistory.model_validate(record) for record in history["descent"]]
    assert steps[-1].grid == (17, 33)
    assert steps[0].level == 0
    last = [step for step in steps if step.level == steps[-1].level]
    assert last[-1].error is not None
    assert last[0].error is not None
    assert last[-1].error <= last[0].error
    rows = list(csv.DictReader(http.get(url, params={"format": "csv"}).text.splitlines()))
    assert len(rows) == len(steps)
    assert (rows[-1]["n_xi"], rows[-1]["n_eta"], rows[-1]["start"]) == ("17", "33", steps[-1].start)
    assert float(rows[-1]["error"]) == steps[-1].error
    drawn = http.get(mesh["links"]["plot"], params={"kind": "convergence", "format": "svg"})
    assert drawn.status_code == 200
    assert "Descent on nested grids" in drawn.text
