"""What a certificate says, in sentences."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_service.worker.summary import sentences_of

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
