"""Pictures of convergence: what they show, also of histories with gaps."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from equimesh.plot.convergence import draw_convergence, draw_histories
from solver.plot.drawings import convergence, texts


def test_convergence_shows_the_components_of_the_error(tmp_path: Path) -> None:
    path = tmp_path / "convergence.svg"
    draw_convergence(convergence(6), path)
    for number in (1, 2):
        assert f"$x$ in subdomain {number}" in texts(path)
        assert f"$y$ in subdomain {number}" in texts(path)
    assert "0.500 measured" in texts(path)
    assert "predicted" not in texts(path)
    draw_convergence(convergence(6, subdomains=9), path)
    assert "in subdomain" not in texts(path)
    assert "error against the single domain" in texts(path)
    draw_convergence({**convergence(6, errors=False), "predicted_rate": 0.25}, path)
    assert "largest change of a node" in texts(path)
    assert "0.250 predicted" in texts(path)


def test_convergence_shows_what_else_is_known_and_marks_what_was_not_asked(tmp_path: Path) -> None:
    path, made = tmp_path / "convergence.svg", convergence(5, errors=False)
    marks = ("took over", "Newton step", "estimated error", "mismatch", "deviation")
    draw_convergence(made, path)
    assert not any(mark in texts(path) for mark in marks)
    for record in made["iterations"]:
        record.update(transmission="linear_robin", estimate=None, mismatch=0.0, deviation=None)
    for record in made["iterations"][3:]:
        record.update(transmission="optimized", estimate=0.2, mismatch=0.1, deviation=0.3, global_step=True)
    draw_convergence(made, path)
    assert "optimized took over from linear_robin" in texts(path)
    assert all(mark in texts(path) for mark in marks)
    assert re.findall(r"^ *(\d+) *$", texts(path), flags=re.MULTILINE)[:5] == ["0", "1", "2", "3", "4"]


def test_convergence_without_numbers(tmp_path: Path) -> None:
    path = tmp_path / "convergence.svg"
    draw_convergence({"iterations": [], "rate": None, "predicted_rate": None}, path)
    assert "single domain" in texts(path)
    for count in (1, 2):
        draw_convergence(convergence(count), path)
        draw_convergence(convergence(count, errors=False), path)
    holes = convergence(4)
    holes["iterations"][2].update(max_q_eq=None, error=math.nan, subdomains=[])
    holes["iterations"][3].update(max_q_eq=math.inf, error=0.0, subdomains=[])
    draw_convergence(holes, path)


@pytest.mark.parametrize(
    ("histories", "marks"),
    [
        ({"ends at nil": [1.0, 1e-8, 0.0]}, {"zero"}),
        ({"blows up": [1.0, math.inf], "has a gap": [1.0, math.nan, 0.1]}, {"infinite"}),
        ({"all": [0.0, math.inf, math.nan]}, {"zero", "infinite"}),
        ({"single": [0.25]}, set()),
        ({"single nil": [0.0]}, {"zero"}),
        ({"constant": [0.5, 0.5, 0.5]}, set()),
        ({"tiny": [5e-324, 1e-300], "huge": [1e300]}, {"zero"}),
        ({"nothing": []}, set()),
        ({}, set()),
    ],
    ids=lambda case: ", ".join(case) if isinstance(case, dict) else "",
)
def test_histories_of_every_kind(histories: dict[str, list[float]], marks: set[str], tmp_path: Path) -> None:
    path = tmp_path / "histories.svg"
    draw_histories(histories, path, title="A title", ylabel="a label", first=1)
    assert {mark for mark in ("zero", "infinite") if mark in texts(path).split()} == marks
    for text in ("A title", "a label", "iteration"):
        assert text in texts(path)


def test_many_long_histories_stay_distinct(tmp_path: Path) -> None:
    histories = {f"p = {number}": [0.9 ** (k * (number + 1)) for k in range(300)] for number in range(16)}
    draw_histories(histories, tmp_path / "many.svg", title="Many")
    for label in histories:
        assert label in texts(tmp_path / "many.svg")
