"""Every monitor, domain and mode of the spec over a real server, and the certificate that comes back."""

from __future__ import annotations

from typing import Any

import httpx
import jsonschema
import numpy as np
import pytest

from service.assembly.specs import ARC, DOMAINS, MONITORS
from service.conftest import small
from service.requests import WAIT, arrays, solved


@pytest.mark.parametrize("domain", DOMAINS)
@pytest.mark.parametrize("monitor", MONITORS)
def test_every_monitor_on_every_domain(http: httpx.Client, monitor: str, domain: str) -> None:
    spec = small(monitor=MONITORS[monitor], domain=DOMAINS[domain], grid={"n_xi": 13, "n_eta": 12})
    mesh = solved(http, spec)
    certificate = mesh["certificate"]
    assert certificate["status"] == mesh["convergence"]["status"]
    assert certificate["min_jacobian"] > 0
    by_descent = certificate["status"] == "completed"
    assert by_descent == (certificate["equation_residual"] is None) == (certificate["mode"] is None)
    assert by_descent == (monitor == "least error") or monitor == "auto"
    chosen = [candidate["kind"] for candidate in certificate["comparison"] if candidate["chosen"]]
    assert len(chosen) == (monitor == "auto")
    if by_descent:
        assert certificate["interpolation_gain"]["l2"] >= 1.0
        assert chosen in ([], ["least_error"])
    has_u = "u" in MONITORS[monitor] or monitor == "intersection"
    assert (certificate["interpolation_gain"] is not None) == has_u
    assert (mesh["quality"]["interpolation_error"] is not None) == has_u
    file = arrays(http, mesh)
    x, y = file["x"], file["y"]
    (x_up, x_down), (y_up, y_down) = ((c[1:, 1:] - c[:-1, :-1], c[:-1, 1:] - c[1:, :-1]) for c in (x, y))
    assert (x_up * y_down - y_up * x_down).min() > 0  # twice the areas, of the diagonals
    if domain == "annulus_sector":
        radius, angle = np.hypot(x, y), np.degrees(np.arctan2(y, x))
        np.testing.assert_allclose(radius[0], 0.5, rtol=1e-12)
        np.testing.assert_allclose(radius[-1], 1.5, rtol=1e-12)
        np.testing.assert_allclose(angle[:, [0, -1]], np.broadcast_to([-20, 100], (13, 2)), atol=1e-9)
    elif domain == "rectangle":
        assert [(c.min(), c.max()) for c in (x, y)] == [(-1, 1), (0, 3)]
    elif domain == "quadrilateral":
        np.testing.assert_allclose(y[:, 0], 0.2 * np.sin(np.pi * x[:, 0]), atol=1e-12)
    assert http.get(mesh["links"]["file"], params={"format": "vtu"}).status_code == 200
    # the canonical spec is complete, and gives the same mesh
    canonical = http.get(mesh["links"]["spec"]).json()
    assert canonical["monitor"].get("smoothing", 0) == MONITORS[monitor].get("smoothing", 0)
    again = solved(http, canonical)
    assert http.get(again["links"]["spec"]).json() == canonical
    np.testing.assert_array_equal(arrays(http, again)["x"], x)
    with_arrays = http.get(mesh["links"]["quality"], params={"arrays": True}).json()
    assert with_arrays["q_eq"]["max"] == pytest.approx(mesh["quality"]["q_eq"]["max"], rel=1e-12)
    assert with_arrays["interpolation_error"] == mesh["quality"]["interpolation_error"]


def test_a_weight_gathers_the_cells(http: httpx.Client) -> None:
    spec = small(monitor={"kind": "weight", "rho": {"expression": "(1 + 3*x)**2"}}, mode="tight")
    x = arrays(http, solved(http, {**spec, "grid": {"n_xi": 65, "n_eta": 5}}))["x"][:, 2]
    exact = (np.sqrt(1 + 15 * np.linspace(0, 1, 65)) - 1) / 3  # equal parts of x + 3/2 x^2
    np.testing.assert_allclose(x, exact, atol=1e-3)


def test_modes(http: httpx.Client) -> None:
    loose, tight = (solved(http, small(monitor=ARC, mode=mode)) for mode in ("discretization", "tight"))
    assert tight["certificate"]["mode"] == "tight"
    assert tight["certificate"]["equation_residual"] < 1e-8
    assert tight["certificate"]["equation_residual"] <= loose["certificate"]["equation_residual"]


# Too steep for its grid: without relaxing it, there is no valid mesh.
HARD = {
    "monitor": {
        "kind": "arc_length",
        "u": {"expression": "tanh(200*((x-0.5)**2 + (y-0.5)**2 - 0.09))"},
        "a": 1.0,
        "b": 0.0,
    },
    "grid": {"n_xi": 16, "n_eta": 16},
}


def test_a_relaxed_mesh_succeeds_and_says_so(http: httpx.Client, document: dict[str, Any]) -> None:
    mesh = solved(http, HARD)
    certificate = mesh["certificate"]
    assert certificate["status"] == mesh["convergence"]["status"] == "relaxed"
    assert certificate["relaxed"]
    assert all(part["asked"] != part["reached"] for part in certificate["relaxed"])
    assert certificate["warnings"]
    assert http.get(mesh["links"]["file"]).status_code == 200
    schema = {"$ref": "#/components/schemas/MeshResource", "components": document["components"]}
    jsonschema.Draft202012Validator(schema).validate(mesh)


def test_relaxing_can_be_forbidden(http: httpx.Client) -> None:
    answer = http.post("/v1/meshes", json={**HARD, "allow_relaxed": False}, headers=WAIT)
    mesh = answer.json()
    assert (answer.status_code, mesh["status"]) == (201, "failed")
    assert (mesh["error"]["type"], mesh["partial"]) == ("/problems/newton-failed", True)
    assert mesh["certificate"]["status"] == "newton_failed"
    assert mesh["certificate"]["relaxed"]
    assert "A relaxed mesh was found, and refused because allow_relaxed is false." in mesh["error"]["detail"]
    assert http.get(mesh["links"]["file"]).status_code == 409
    assert http.get(mesh["links"]["file"], params={"partial": True}).status_code == 200
