"""The progress bar of solves, rounds and the command line."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

import equimesh as em
from equimesh_coupling import progress_bar
from equimesh_coupling.progress_bar import Bar, ProgressBar


def test_a_long_phase_is_cut_to_the_width_of_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with Bar(True) as bar:
        bar._line.ncols = 80
        bar.show(0.5, "comparing monitors, 2 of 4: " + 20 * "word ")
    lines = capsys.readouterr().err.split("\r")
    assert max(map(len, lines)) <= 80
    assert any("word" in line and line.endswith("…") for line in lines)


def test_it_tells_the_gain_of_a_descent() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    step = em.Descent(
        level=0, levels=2, grid=mesh.grid, step=3, steps=20, error=0.1, gain=4.25, distortion=0.0,
        min_jacobian=1.0, mesh=mesh, start="uniform", fraction=0.5, phase="descending, step 3 of 20",
    )  # fmt: skip
    said: list[tuple[float | None, str]] = []
    with ProgressBar(True, share=0.8, delay=0.0) as bar:
        bar.show = lambda share, words: said.append((share, words))  # type: ignore[method-assign]
        bar(step)
        bar(replace(step, start="initial"))
    assert said == [
        (0.4, "descending, step 3 of 20, error 1.0e-01, 4.2 times smaller than on the uniform mesh"),
        (0.4, "descending, step 3 of 20, error 1.0e-01, 4.2 times smaller than on the initial mesh"),
    ]


def test_solves_and_rounds_show_their_steps(capsys: pytest.CaptureFixture[str]) -> None:
    u = em.Expression("tanh(6*(x - y))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(9, 9))
    em.solve(problem, observe=ProgressBar(True, delay=0.0))
    em.solve(problem, em.Schwarz(subdomains=(2, 1)), observe=ProgressBar(True, delay=0.0))
    em.adapt(lambda mesh: u.evaluate(mesh.x, mesh.y)[0], 9, rounds=1, observe=ProgressBar(True, delay=0.0))
    said = capsys.readouterr().err
    for words in ("residual", "change", "round 1, estimated error"):
        assert words in said, words


def test_the_short_call_shows_its_progress_where_it_is_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress_bar, "DELAY", 0.0)
        em.mesh("tanh(6*(x - y))", 9, monitor="arc_length", progress=True)
        assert "residual" in capsys.readouterr().err
        em.mesh("tanh(6*(x - y))", 9, monitor="arc_length")
    assert capsys.readouterr().err == ""


def test_a_short_solve_shows_no_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(True, delay=3600.0) as bar:
        bar.show(0.5, "words")
    assert capsys.readouterr().err == ""


def test_a_line_that_came_late_is_taken_away(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(True, delay=1e-9) as bar:
        bar.show(0.5, "words")
    assert capsys.readouterr().err.split("words")[1].split("\r")[-2].strip() == ""


def test_only_a_failure_leaves_the_bar_of_a_notebook_unfinished() -> None:
    bars = [Bar(True), Bar(True), Bar(True)]
    lines = [bar._line for bar in bars]
    for bar in bars:
        bar.show(0.5, "words")
    with bars[0]:
        pass
    with pytest.raises(ZeroDivisionError), bars[1]:
        raise ZeroDivisionError
    del bar, bars  # as an observer, which nobody closes
    assert [line.n for line in lines] == [100.0, 50.0, 100.0]
    assert all(line.disable for line in lines)


def test_a_notebook_shows_it_although_it_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kernel = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=object(), config={}))
    monkeypatch.setitem(sys.modules, "IPython", kernel)
    assert progress_bar.in_notebook()
    with Bar(None) as bar:
        assert bar.shown
        bar.show(0.5, "words")
    assert "words" in capsys.readouterr().err
    kernel.get_ipython = lambda: SimpleNamespace(config={})  # the prompt of a terminal, here without one
    assert not Bar(None).shown
