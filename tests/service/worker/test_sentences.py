"""What a certificate says, in sentences, with the comparison and the history of a convergence."""

from __future__ import annotations

import csv
from typing import Any

import httpx
import numpy as np
import pytest

import equimesh as em
from equimesh_service.worker.drawing import compare
from equimesh_service.worker.summary import DescentHistory, sentences_of
from service.requests import WAIT

PLAIN: dict[str, Any] = {
    "interpolation_gain": {"l2": 5.4, "h1": 1.5},
    "relaxed": [],
    "warnings": [],
    "target": None,
    "comparison": [],
}


def said(**changes: Any) -> list[tuple[str, str]]:
    norm, error = changes.pop("norm", "l2"), changes.pop("error", None)
    return [(found["tone"], found["text"]) for found in sentences_of({**PLAIN, **changes}, norm, error)]


@pytest.mark.parametrize(
    ("gain", "tone", "words"),
    [
        (5.4, "good", "5.4 times smaller than on a uniform mesh"),
        (123.4, "good", "123 times smaller"),
        (9.97, "good", "10 times smaller"),
        (1.05, "good", "4.8 % smaller"),
        (1.001, "note", "that of the uniform mesh"),
        (0.96, "bad", "4.2 % larger"),
        (0.25, "bad", "4 times larger than on a uniform mesh"),
    ],
)
def test_the_gain_is_said_in_words(gain: float, tone: str, words: str) -> None:
    ((found, text),) = said(interpolation_gain={"l2": gain, "h1": 7.0})
    assert found == tone
    assert text.startswith("The error of interpolating u is ")
    assert words in text


def test_the_error_is_that_of_the_norm_of_the_monitor() -> None:
    assert said(norm="h1") == [("good", "The error of the gradient is 1.5 times smaller than on a uniform mesh.")]


def test_the_degree_of_the_elements_is_said_where_it_is_not_1() -> None:
    assert said(degree=1) == said()
    known = "The error of interpolating u by elements of degree 2 is 5.4 times smaller than on a uniform mesh."
    assert said(degree=2) == [("good", known)]


def test_what_a_solver_gets_is_said_where_it_is_known() -> None:
    gains = {"l2": 3.2, "h1": 0.5, "points": 81}
    assert said(solver_gain=gains) == [("good", "A solver's error is 3.2 times smaller than on a uniform mesh.")]
    bad = "A solver's error of the gradient is 2 times larger than on a uniform mesh."
    assert said(solver_gain=gains, norm="h1") == [("bad", bad)]
    for unknown in (None, {"l2": None, "h1": None, "points": 81}):
        assert said(solver_gain=unknown) == said()


def test_an_unknown_gain_is_left_to_the_warning() -> None:
    assert said(interpolation_gain={"l2": None, "h1": None}, warnings=["A layer."]) == [("warning", "A layer.")]
    assert said(interpolation_gain=None) == [("note", "There is no u, so no interpolation error is measured.")]


def test_every_relaxation_is_said_once() -> None:
    relaxed = [{"what": "a", "asked": 0.7, "reached": 0.3}, {"what": "distortion", "asked": 0.5, "reached": 2.0}]
    warning = "The mesh solves relaxed equations: a of the arc length: 0.7 requested, 0.3 reached."
    assert said(relaxed=relaxed, warnings=[warning])[1:] == [
        ("note", "Relaxed: distortion: 0.5 requested, 2 reached."),
        ("warning", warning),
    ]


def test_a_failure_comes_first_with_its_remedy() -> None:
    error = {"title": "Mesh folded", "detail": "A cell is inverted.", "remedy": "Add points."}
    assert said(error=error)[0] == ("bad", "Mesh folded. A cell is inverted. Add points.")


@pytest.mark.parametrize(("reached", "tone"), [(9e-5, "good"), (2e-4, "bad")])
def test_a_target_is_compared_with_what_was_reached(reached: float, tone: str) -> None:
    target = {"error": 1e-4, "reached": reached, "grid": [33, 17]}
    assert said(target=target)[1] == (tone, f"An error of 0.0001 was requested, and 33 x 17 points have {reached:.2g}.")


def test_the_choice_of_auto_is_named() -> None:
    compared = [{"kind": "least_error", "chosen": True}, {"kind": "arc_length", "chosen": False}]
    assert said(understood={"monitor.u": "2*x"})[1:] == [("note", "What was typed was read as u = 2*x.")]
    assert said(comparison=compared)[1:] == [("note", "Of the monitors that were compared, least error was chosen.")]
    assert len(said(comparison=[{"kind": "nodal_solution", "chosen": True}])) == 1


U = em.Expression("tanh(20*(x + y/2 - 0.75))")


@pytest.mark.parametrize(
    "monitor", [em.Auto(u=U, cells="triangle"), em.ArcLength(u=U), em.Weight(rho=em.Expression("1 + x"))]
)
def test_a_mesh_is_compared_as_its_solution_was(monitor: em.Monitor) -> None:
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=17, n_eta=17))
    solution = em.solve(problem)
    expected = solution.against_uniform
    found = compare(solution.mesh, problem, solution.certificate.summary())
    assert found.gain == (expected.gain and pytest.approx(expected.gain, rel=1e-12))
    for mine, its in ((found.adapted, expected.adapted), (found.uniform, expected.uniform)):
        assert (mine.error is None) == (its.error is None) == isinstance(monitor, em.Weight)
        if mine.error is not None and its.error is not None:
            assert np.allclose(mine.error, its.error, rtol=1e-9, atol=1e-15)


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
    assert last[-1].error <= last[0].error
    rows = list(csv.DictReader(http.get(url, params={"format": "csv"}).text.splitlines()))
    assert len(rows) == len(steps)
    assert (rows[-1]["n_xi"], rows[-1]["n_eta"], rows[-1]["start"]) == ("17", "33", steps[-1].start)
    assert float(rows[-1]["error"]) == steps[-1].error
    drawn = http.get(mesh["links"]["plot"], params={"kind": "convergence", "format": "svg"})
    assert drawn.status_code == 200
    assert "Descent on nested grids" in drawn.text
