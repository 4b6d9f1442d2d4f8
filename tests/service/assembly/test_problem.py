"""Every monitor, domain and mode of the spec over a real server, and the certificate that comes back."""

from __future__ import annotations

import io
import itertools
from dataclasses import replace
from typing import Any

import httpx
import jsonschema
import numpy as np
import pytest

from equimesh import Acceleration, LocalSolver, Ordering, Schwarz
from equimesh.specs import build_schwarz
from equimesh_service.admission.tasks import PackedProblems
from equimesh_service.spec.mesh import read_spec
from service.assembly.specs import ARC, DOMAINS, MONITORS
from service.conftest import small
from service.requests import WAIT, arrays, solved

# Each monitor on one domain, and each domain with two monitors or more; tests/proofs/test_monitors_on_domains.py has
# the equations on all of them, and tests/proofs/test_conformance.py other pairs.
PAIRS = [(monitor, [*DOMAINS][k % len(DOMAINS)]) for k, monitor in enumerate(MONITORS)]


@pytest.mark.parametrize(("monitor", "domain"), PAIRS)
def test_every_monitor_and_every_domain(http: httpx.Client, monitor: str, domain: str) -> None:
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
    # Errors of a chosen candidate were measured with those of the others, in another order of sums.
    errors, known = with_arrays["interpolation_error"], mesh["quality"]["interpolation_error"]
    assert errors == (pytest.approx(known, rel=1e-12) if has_u else None)


def test_the_next_mesh_of_a_solver(http: httpx.Client) -> None:
    where: dict[str, Any] = {"domain": DOMAINS["annulus_sector"], "grid": {"n_xi": 13, "n_eta": 12}}
    before = arrays(http, solved(http, small(monitor={"kind": "weight", "rho": "1"}, **where)))
    x, y = before["x"], before["y"]
    nodal = {"x": x.tolist(), "y": y.tolist(), "values": np.tanh(8 * (x - y)).tolist()}
    spec = small(monitor={"kind": "nodal_solution", "u": {"nodal": nodal}}, **where)
    mesh = solved(http, spec)
    certificate, after = mesh["certificate"], arrays(http, mesh)
    assert (certificate["status"], certificate["mode"]) == ("completed", None)
    assert certificate["estimate"]["l2"] > 0.0
    assert certificate["min_jacobian"] > 0.0
    assert abs(after["x"] - x).max() > 1e-3
    for side in ("left", "right", "bottom", "top"):
        np.testing.assert_array_equal(after[side], before[side])
    # the same values as a file
    file = io.BytesIO()
    np.savez(file, **{name: np.asarray(values) for name, values in nodal.items()})
    stored = http.post("/v1/samples", content=file.getvalue(), headers={"Content-Type": "application/x-npz"}).json()
    assert stored["kind"] == "nodal"
    again = solved(http, {**spec, "monitor": {"kind": "nodal_solution", "u": {"samples": stored["id"]}}})
    np.testing.assert_array_equal(arrays(http, again)["x"], after["x"])


@pytest.mark.parametrize(
    ("changed", "pointer"),
    [
        ({"grid": {"n_xi": 9, "n_eta": 9}}, "/grid"),
        ({"grid": None, "target": {"error": 0.1}}, "/target/error"),
        ({"schwarz": {"subdomains": [2, 1]}}, "/schwarz"),
        ({"monitor": {"kind": "nodal_solution", "u": "x"}}, "/monitor/u"),
    ],
)
def test_what_a_round_cannot_have_is_refused(http: httpx.Client, changed: dict[str, Any], pointer: str) -> None:
    axis = np.linspace(0.0, 1.0, 12)
    x, y = (q.tolist() for q in np.meshgrid(axis, axis, indexing="ij"))
    nodal = {"kind": "nodal_solution", "u": {"nodal": {"x": x, "y": y, "values": x}}}
    spec = {"monitor": nodal, "grid": {"n_xi": 12, "n_eta": 12}, **changed}
    answer = http.post("/v1/meshes", json={name: value for name, value in spec.items() if value is not None})
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["pointer"] == pointer


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


def test_packed_problems_are_taken_once_and_the_oldest_are_forgotten() -> None:
    problems = PackedProblems(max_bytes=10)
    for mesh_id in ("a", "b", "c"):
        problems.put(mesh_id, b"1234")
    assert problems.take("a") is None
    assert (problems.take("c"), problems.take("c")) == (b"1234", None)
    problems.put("d", b"12345678901")
    assert (problems.take("b"), problems.take("d")) == (None, None)


# The Schwarz iteration of a spec: every choice reaches the solver.


KINDS: list[dict[str, Any]] = [
    {"kind": "optimized"},
    {"kind": "optimized", "data": "local"},
    {"kind": "classical"},
    {"kind": "linear_robin", "p": 2.3},
    {"kind": "nonlinear_robin"},
]


def test_every_condition_and_every_ordering_are_taken(http: httpx.Client) -> None:
    asked = [
        small(schwarz={"transmission": kind, "ordering": ordering, "tolerance": None, "max_iterations": 2})
        for kind, ordering in zip(KINDS, itertools.cycle(Ordering), strict=False)
    ]
    posted = [http.post("/v1/meshes", json=spec).json() for spec in asked]
    for spec, mesh in zip(asked, posted, strict=True):
        done = http.get(mesh["links"]["self"], params={"wait": 300}).json()
        assert done["status"] == "succeeded", (spec, done["error"])
        assert done["convergence"]["transmission"].startswith(spec["schwarz"]["transmission"]["kind"])


@pytest.mark.parametrize(
    ("asked", "built"),
    [
        ({}, Schwarz()),
        (
            {
                "line_correction": 2,
                "acceleration": "anderson",
                "local_solver": "newton",
                "fallback": False,
                "tolerance": "discretization",
            },
            Schwarz(
                line_correction=2,
                acceleration=Acceleration.ANDERSON,
                local_solver=LocalSolver.NEWTON,
                fallback=False,
                tolerance="discretization",
            ),
        ),
    ],
)
def test_the_solver_is_given_what_was_asked(asked: dict[str, Any], built: Schwarz) -> None:
    assert build_schwarz(read_spec(small(schwarz=asked)).canonical) == built


def test_subdomains_of_least_error_descend(http: httpx.Client) -> None:
    schwarz = {"subdomains": [2, 2], "overlap": 3, "local_steps": 4, "max_exchanges": 2}
    spec = small(monitor={"kind": "least_error", "u": "tanh(9*(x - y*y))"}, schwarz=schwarz)
    mesh = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}).json()
    assert mesh["status"] == "succeeded", mesh["error"]
    history = http.get(mesh["links"]["convergence"]).json()
    assert history["descent"][-1]["gain"] > 1.0
    assert [record["step"] for record in history["descent"][-3:]] == [0, 1, 2]
    picture = http.get(f"{mesh['links']['self']}/plot", params={"kind": "mesh", "format": "svg"})
    assert picture.status_code == 200
    assert http.get(f"{mesh['links']['self']}/drawing").status_code == 200


def test_keys_that_came_later_leave_the_points_of_earlier_meshes() -> None:
    checked = read_spec(small(schwarz={}))
    settings = {k: v for k, v in checked.canonical["schwarz"].items() if k not in {"local_steps", "max_exchanges"}}
    earlier = replace(checked, canonical={**checked.canonical, "schwarz": settings})
    assert checked.points_digest == earlier.points_digest
    assert read_spec(small(schwarz={"local_steps": 4})).points_digest != checked.points_digest


@pytest.mark.parametrize(("kind", "measured"), [("arc_length", False), ("least_error", True), ("nodal_solution", True)])
def test_points_depend_on_the_cells_where_errors_are_measured_on_them(kind: str, measured: bool) -> None:
    corners = [[0.0, 0.0], [1.0, 1.0]]
    nodal = {"nodal": {"x": corners, "y": [[0.0, 1.0], [0.0, 1.0]], "values": corners}}
    u = nodal if kind == "nodal_solution" else "x*y"
    quad, triangle = (read_spec(small(monitor={"kind": kind, "u": u}, cells=cells)) for cells in ("quad", "triangle"))
    assert (quad.points_digest != triangle.points_digest) is measured
    assert quad.monitor_digest != triangle.monitor_digest
