"""The history of a convergence."""

from __future__ import annotations

import httpx

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
