"""The uniform mesh next to the adapted one: one scale of colours, and the gain in words."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from equimesh.plot.meshes import DECADES, MIN_DECADES, _scale, draw_comparison, words
from solver.plot.drawings import compared, texts

matplotlib = pytest.importorskip("matplotlib")


@pytest.mark.parametrize(
    ("gain", "told"),
    [
        (13.125, "error 13.1 times smaller, with the same 12 × 10 points"),
        (191.8, "error 192 times smaller, with the same 12 × 10 points"),
        (0.4, "error 2.5 times larger, with the same 12 × 10 points"),
        (1.001, "the same error, with the same 12 × 10 points"),
        (None, "No u is given, so there is no error to compare (12 × 10 points)"),
    ],
)
def test_the_gain_is_told_in_words_below_the_picture(gain: float | None, told: str, tmp_path: Path) -> None:
    comparison = compared(gain)
    assert words(comparison) == told
    draw_comparison(comparison, tmp_path / "pair.svg")
    assert told in texts(tmp_path / "pair.svg")
    assert ("interpolation error of u" in texts(tmp_path / "pair.svg")) == (gain is not None)


def test_a_folded_mesh_has_grey_cells_and_no_gain(tmp_path: Path) -> None:
    comparison = compared()
    assert comparison.interpolation is not None
    folded = replace(
        comparison,
        adapted=replace(comparison.adapted, error=np.full((11, 9), np.inf)),
        interpolation=replace(comparison.interpolation, l2=math.inf),
    )
    assert words(folded) == "The mesh is folded, and has no error (12 × 10 points)"
    draw_comparison(folded, tmp_path / "folded.png")
    image = matplotlib.image.imread(tmp_path / "folded.png")[..., :3]
    grey = abs(image - 0x77 / 255).max(axis=-1) < 0.02
    left, right = np.split(grey[:, : image.shape[1] // 2 * 2], 2, axis=1)
    assert left.mean() < 0.01
    assert right.mean() > 0.2


def test_both_meshes_have_one_scale_of_colours(tmp_path: Path) -> None:
    draw_comparison(compared(), tmp_path / "pair.png")  # the error is ten times smaller on the right
    image = matplotlib.image.imread(tmp_path / "pair.png")[..., :3]
    palette = matplotlib.colormaps["YlOrRd"]
    places = {}
    for end in (0.0, 1.0):
        near = abs(image - palette(end)[:3]).max(axis=-1) < 0.02
        near[int(0.7 * len(near)) :] = False  # without the scale below
        places[end] = np.nonzero(near)[1].mean() / image.shape[1]
    assert places[1.0] < 0.5 < places[0.0]


def test_the_scale_spans_some_decades_below_the_largest_error() -> None:
    for smallest, decades in ((1e-9, DECADES), (1e-2, 2.0), (0.9, MIN_DECADES)):
        scale = _scale([np.array([smallest, 0.0, np.inf]), np.array([1.0, np.nan])])
        assert scale.vmax == 1.0
        assert scale.vmin == pytest.approx(10.0**-decades)
    assert (_scale([]).vmin, _scale([]).vmax) == (0.1, 1.0)


def test_wide_domains_are_drawn_one_below_the_other(tmp_path: Path) -> None:
    u = em.Expression("tanh(20*(x - 1 - y/2))")
    for domain, is_high in ((em.Rectangle(x=(0, 3)), True), (em.Rectangle(), False)):
        problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=25, n_eta=9), domain=domain)
        solution = em.solve(problem)
        draw_comparison(solution.against_uniform, tmp_path / "pair.png")
        image = matplotlib.image.imread(tmp_path / "pair.png")
        assert (image.shape[0] > 0.75 * image.shape[1]) == is_high
        assert image.shape[1] == 1050
