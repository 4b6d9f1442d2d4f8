"""Pictures of a descent: what they show, also of records with gaps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from equimesh import Expression, Grid, LeastError, Problem, solve
from equimesh.plot.convergence import draw_convergence, draw_descent
from solver.plot.drawings import texts


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
