"""Pictures of convergence: what they show, also of histories with gaps."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from equimesh import Expression, Grid, LeastError, Problem, solve
from equimesh.plot.convergence import draw_convergence, draw_descent, draw_histories
from solver.plot.drawings import convergence, texts

pytestmark = pytest.mark.usefixtures("without_layout")


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
    draw_convergence(convergence(1), path)
    draw_convergence(convergence(2, errors=False), path)
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
        ({"single": [0.25], "single nil": [0.0]}, {"zero"}),
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


# Pictures of a descent: what they show, also of records with gaps.


def record(level: int, step: int, start: str = "uniform", **more: Any) -> dict[str, Any]:
    points = 8 * 2**level + 1
    numbers = {"error": 0.1 / (step + 1), "gain": 1.0 + step, "distortion": 1.0, "min_jacobian": 0.5}
    return {"level": level, "grid": [points, points], "start": start, "step": step, **numbers, **more}


def test_every_grid_and_every_start_has_its_name(tmp_path: Path) -> None:
    path = tmp_path / "descent.svg"
    draw_descent([record(0, 1), record(0, 2), record(0, 1, "rectilinear"), record(1, 1)], path)
    said = texts(path)
    for words in ("9 x 9 points", "17 x 17 points", "from a uniform mesh", "from a rectilinear mesh"):
        assert said.count(words) == 1, words
    draw_descent([record(0, 1), record(1, 1)], path)
    assert "from a uniform mesh" not in texts(path)


def test_gaps_are_drawn_as_gaps(tmp_path: Path) -> None:
    path = tmp_path / "descent.png"
    draw_descent([record(0, 0, gain=None), record(0, 1, error=0.0), record(1, 0, error=None, gain=None)], path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_the_history_of_a_solution_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "descent.svg"
    u = Expression("tanh(20*(x + y/2 - 0.75))")
    solution = solve(Problem(monitor=LeastError(u=u), grid=Grid(n_xi=17, n_eta=33)), threads=1)
    draw_convergence(solution.convergence(), path)
    assert "Descent on nested grids" in texts(path)
    assert "17 x 33 points" in texts(path)


def test_levels_of_blocks_are_named_by_their_points(tmp_path: Path) -> None:
    path = tmp_path / "descent.svg"
    coarse, fine = record(0, 1, "initial", points=225), record(1, 1, "initial", points=833)
    draw_descent([{name: value for name, value in one.items() if name != "grid"} for one in (coarse, fine)], path)
    for words in ("225 points", "833 points", "Descent on nested meshes", "on the initial mesh"):
        assert words in texts(path), words
