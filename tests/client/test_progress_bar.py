"""The progress bar."""

from __future__ import annotations

import pytest

from equimesh_client.progress_bar import Watch

RECORD = {
    "status": "running",
    "progress": {
        "stage": "single_domain",
        "phase": "sweeping the 65 x 65 grid",
        "iteration": 3,
        "residual": 1.5e-4,
        "fraction": 0.5,
    },
}


def test_it_shows_percentage_phase_and_figures(capsys: pytest.CaptureFixture[str]) -> None:
    with Watch(True) as watch:
        watch.update(RECORD)
        watch.update({"status": "succeeded", "progress": {"stage": "done"}})
    shown = capsys.readouterr().err
    for words in (" 50%", "sweeping the 65 x 65 grid, residual 1.5e-04", "done", "100%"):
        assert words in shown, words


def test_of_a_descent_it_shows_the_gain(capsys: pytest.CaptureFixture[str]) -> None:
    descent = {
        "stage": "least_error",
        "phase": "descending, step 4 of 45",
        "iteration": 4,
        "residual": None,
        "gain": 3.26,
        "fraction": 0.25,
    }
    with Watch(True) as watch:
        watch.update({"status": "running", "progress": descent})
    shown = capsys.readouterr().err
    assert "descending, step 4 of 45, error 3.3 times smaller" in shown
    assert "residual" not in shown


@pytest.mark.parametrize("progress", [False, None])
def test_without_a_terminal_it_shows_nothing_unless_requested(
    progress: bool | None, capsys: pytest.CaptureFixture[str]
) -> None:
    with Watch(progress) as watch:
        assert not watch.shown
        watch.update(RECORD)
    assert capsys.readouterr().err == ""


def test_it_never_runs_backwards(capsys: pytest.CaptureFixture[str]) -> None:
    with Watch(True) as watch:
        watch.update(RECORD)
        watch.update({**RECORD, "progress": {"fraction": 0.1}})
    assert capsys.readouterr().err.rstrip().split("\r")[-1].split("|")[0] == " 50% "


def test_where_nobody_knows_the_work_ahead_it_shows_no_percentage(capsys: pytest.CaptureFixture[str]) -> None:
    with Watch(True) as watch:
        watch.update({"status": "queued", "progress": {"stage": "queued", "fraction": 0.0}})
        watch.update({"status": "running", "progress": {"phase": "relaxing, step 12", "fraction": None}})
    shown = capsys.readouterr().err
    assert "queued" in shown
    assert "relaxing, step 12" in shown
    assert "%" not in shown
