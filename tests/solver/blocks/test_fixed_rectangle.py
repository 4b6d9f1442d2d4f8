"""Nodes inside a rectangle, and between blocks, that stay or slide: exactly, and in every kind of solve."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh import specs
from equimesh.blocks.fixed_rectangle import SIDES
from solver.blocks import documents

U = "tanh(20*(x - y + 0.1*sin(5*x)))"
POINTS = [(0.3, 0.4), (0.31, 0.8), (0.71, 0.41), (0.5, 0.6)]
WAVE = {"x": "t", "y": "0.6 + 0.05*sin(2*pi*t)"}
BULGE = {"x": "t", "y": "0.5 + 0.4*t*(1 - t)"}
THIN = {"first": 1e-3, "growth": 1.0, "count": 100}
ALL: dict[str, Any] = {
    "cells": (16, 20),
    "points": POINTS,
    "curves": {"wave": WAVE, "slanted": {"polyline": [[0.15, 0], [0.2, 1]]}},
    "layers": {"bottom": {"first": 0.002, "growth": 1.3, "count": 4}},
}


@cache
def with_all() -> em.Blocks:
    return em.Blocks.rectangle(**ALL)


def assert_stays(mesh: em.Mesh, blocks: em.Blocks) -> None:
    """Points have a node, nodes of curves lie on these, those of layers at their heights."""
    assert not mesh.is_folded
    for x, y in POINTS:
        assert np.hypot(mesh.x - x, mesh.y - y).min() < 1e-15
    wave, slanted, *_ = (
        np.unique(np.concatenate([edge.nodes for edge in blocks.fixed_edges if edge.curve == k])) for k in (0, 1)
    )
    x, y = mesh.points[wave].T
    assert np.abs(y - (0.6 + 0.05 * np.sin(2 * np.pi * x))).max() < 1e-12
    x, y = mesh.points[slanted].T
    assert np.abs(x - (0.15 + 0.05 * y)).max() < 1e-12
    heights = np.cumsum(0.002 * 1.3 ** np.arange(4))
    for height in heights:
        assert np.count_nonzero(np.abs(mesh.y - height) < 1e-12) == 17
    near = mesh.y[(mesh.y > 0.0) & (mesh.y < heights[-1] + 1e-4)]
    assert np.isin(np.round(near, 12), np.round(heights, 12)).all()


@pytest.mark.parametrize(
    "monitor", [em.LeastError(u=U), em.LeastError(u=U, norm="h1"), em.Auto(u=U)], ids=["l2", "h1", "auto"]
)
def test_nodes_stay_in_solves(monitor: Any) -> None:
    blocks = with_all()
    assert blocks.points == 17 * 21
    solution = em.solve(em.Problem(monitor=monitor, domain=blocks))
    assert_stays(solution.mesh, blocks)
    assert solution.gain > 1.5
    assert np.hypot(*(solution.mesh.points - blocks.mesh.points).T).max() > 0.05  # all others moved


def test_nodes_stay_between_subdomains_in_sequences_and_in_rounds() -> None:
    blocks = with_all()
    problem = em.Problem(monitor=em.LeastError(u=U), domain=blocks)
    groups = [range(k, len(blocks.mesh.blocks), 2) for k in (0, 1)]
    assert_stays(em.solve(problem, em.Schwarz(groups=[list(group) for group in groups])).mesh, blocks)
    sequence = em.Sequence(problem, smoothing=0.4)
    assert_stays(sequence.step("tanh(20*(x - y + 0.2))").mesh, blocks)
    found = em.adapt(lambda mesh: np.tanh(20 * (mesh.x - mesh.y)), domain=blocks, rounds=2)
    assert_stays(found.mesh, blocks)


def test_an_interface_between_blocks_keeps_its_nodes_on_its_circle() -> None:
    corners, inner = {"a": [-1, -1], "b": [1, -1], "c": [1, 1], "d": [-1, 1]}, 0.3
    rim = {name: [0.5 * x / 2**0.5, 0.5 * y / 2**0.5] for name, (x, y) in zip("efgh", corners.values(), strict=True)}
    core = {name: [inner * x / 2, inner * y / 2] for name, (x, y) in zip("ijkl", corners.values(), strict=True)}
    around = [["a", "b", "f", "e"], ["b", "c", "g", "f"], ["c", "d", "h", "g"], ["d", "a", "e", "h"]]
    within = [["e", "f", "j", "i"], ["f", "g", "k", "j"], ["g", "h", "l", "k"], ["h", "e", "i", "l"]]
    rims = [["e", "f"], ["f", "g"], ["g", "h"], ["h", "e"]]
    document = {
        "vertices": corners | rim | core,
        "curves": {"circle": {"circle": {"radius": 0.5}}},
        "edges": [{"from": one, "to": other, "on": "circle"} for one, other in rims],
        "blocks": [{"corners": names, "cells": [8, 6]} for names in (*around, *within)]
        + [{"corners": ["i", "j", "k", "l"]}],
        "fixed": rims,
    }
    blocks = em.Blocks.of(document)
    rim_nodes = np.unique(np.concatenate([edge.nodes for edge in blocks.fixed_edges]))
    assert rim_nodes.size == 32
    assert blocks.area == pytest.approx(4.0, rel=1e-12)
    mesh = em.solve(em.Problem(monitor=em.LeastError(u="tanh(10*(x + y))"), domain=blocks)).mesh
    assert np.abs(np.hypot(*mesh.points[rim_nodes].T) - 0.5).max() < 1e-15
    assert np.hypot(*(mesh.points - blocks.mesh.points)[rim_nodes].T).max() > 0.02
    free = em.Blocks.of({name: value for name, value in document.items() if name != "fixed"})
    assert (free.node_curve[rim_nodes] == -1).all()


def test_edges_of_the_boundary_and_doubled_ones_are_refused() -> None:
    for fixed, sentence in (
        ([["a", "b"]], "a-b is no edge between two blocks"),
        ([["b", "e"], ["e", "b"]], "e-b is named twice"),
        ([["a", "f"]], "a-f"),
        ([["a", "q"]], "q"),
    ):
        with pytest.raises(em.InputError, match=sentence) as caught:
            em.Blocks.of(documents.l_shape(fixed=fixed))
        assert caught.value.field.startswith(f"domain.fixed[{len(fixed) - 1}]")


@pytest.mark.parametrize(
    ("given", "field", "sentence"),
    [
        ({"points": [(0.3, 0.4), (0.3, 0.4)]}, "domain.points[1]", "there twice"),
        ({"curves": [[0, 1]]}, "domain.curves", "such as {'interface'"),
        ({"layers": {"left": 0.1}}, "domain.layers.left", "such as {'first'"),
        ({"points": [(2, 2)]}, "domain.points[0]", r"points\[0\] = \(2, 2\) is not inside .* x from 0 to 1"),
        ({"curves": {"a": {"x": "t", "y": "2"}}}, "domain.curves.a", "let it run inside"),
        ({"cells": 8}, "domain.cells", "two numbers, those along x and along y"),
        ({"points": [(0.1 + k / 50, 0.5 + k / 99) for k in range(40)]}, "domain.points", "no line is left"),
        ({"cells": (2, 2), "points": POINTS}, "domain.points", "no line is left"),
        ({"layers": {"bottom": {"first": 0.3}}}, "domain.layers.bottom", "do not fit"),
        ({"layers": {"left": {"first": 0.01, "count": 32}}}, "domain.layers.left", "do not fit"),
        ({"layers": {"floor": {"first": 0.3}}}, "domain.layers.floor", "floor"),
        ({"layers": {"bottom": {"first": -1}}}, "domain.layers.bottom.first", "positive"),
        ({"curves": {"c": {"circle": {"radius": 0.2}}}}, "domain.curves.c", "from the left side to the right one"),
        ({"curves": {"a": WAVE, "b": WAVE}}, "domain.curves", "a and b meet"),
        ({"cells": (4, 2), "curves": {"a": WAVE, "b": {"x": "t", "y": "0.8"}}}, "domain.curves.b", "no line is left"),
        ({"curves": {"a": WAVE, "b": {"x": "t", "y": "0.3 + 0.4*t"}}}, "domain.curves", "meet near x ="),
        ({"x": (1, 0)}, "domain.x", "increase"),
        ({"cells": (0, 4)}, "domain.cells[0]", "0"),
        ({"points": [(0.5, 0.5)] * 1001}, "domain.points", "1000 are possible"),
        ({"cells": (250, 250), "layers": dict.fromkeys(SIDES, THIN)}, "domain", "10000 are possible"),
        ({"points": [(0.5, 0.5), (0.5 + 1e-12, 0.5)]}, "domain.points[1]", "twice, or nearly"),
        ({"points": [(0.02, 0.52)], "curves": {"a": BULGE}}, "domain", r"block .* move points or curves apart"),
        ({"curves": {"a": {"points": "wave.dat"}}}, "domain.curves.a.points", "name of a file"),
    ],
)
def test_what_does_not_fit_is_refused(given: dict[str, Any], field: str, sentence: str) -> None:
    with pytest.raises(em.InputError, match=sentence) as caught:
        em.Blocks.rectangle(**({"cells": (16, 16)} | given))
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("cells", "points", "curves"),
    [
        ((16, 20), [(0.4, 0.5), (0.401, 0.5), (0.4, 0.501), (0.402, 0.503), (0.9, 0.61)], {"wave": WAVE}),
        ((4, 5), [(0.2, 0.3), (0.3, 0.8), (0.5, 0.6), (0.7, 0.2), (0.9, 0.7)], {}),
    ],
    ids=["the last next to the wave", "more points than lines"],
)
def test_points_have_common_lines_that_do_not_meet(cells: Any, points: Any, curves: Any) -> None:
    blocks = em.Blocks.rectangle(cells=cells, points=points, curves=curves)
    for x, y in points:
        assert np.hypot(blocks.mesh.x - x, blocks.mesh.y - y).min() < 1e-15
    assert not blocks.mesh.is_folded


def test_curves_have_files_of_points(tmp_path: Path) -> None:
    (tmp_path / "line.dat").write_text("0 0.4\n0.5 0.5\n1 0.4\n")
    given: dict[str, Any] = {"cells": [8, 8], "curves": {"line": {"polyline": "line.dat"}}}
    document = {"monitor": {"kind": "least_error", "u": "x*y"}, "domain": {"kind": "fixed_rectangle", **given}}
    (tmp_path / "problem.json").write_text(json.dumps({**document, "grid": None}))
    for blocks in (em.Blocks.rectangle(**given, folder=tmp_path), specs.load(tmp_path / "problem.json").problem.domain):
        assert np.hypot(blocks.mesh.x - 0.5, blocks.mesh.y - 0.5).min() < 1e-15


def test_documents_have_it_as_a_domain() -> None:
    document = {"kind": "fixed_rectangle", **ALL}
    made = specs.build({"monitor": {"kind": "least_error", "u": U}, "domain": document, "grid": None}).problem
    assert made.points == specs.count_points(document) == 17 * 21
    assert (made.domain.mesh.points == with_all().mesh.points).all()
    again = em.Blocks.of(with_all().description())
    assert (again.node_curve == made.domain.node_curve).all()


def test_without_anything_fixed_it_is_one_block() -> None:
    plain = em.Blocks.rectangle((0, 2), np.array([1, 2]), np.array([8, 4]), points=None)
    assert len(plain.mesh.blocks) == 1
    assert plain.box == ((0.0, 2.0), (1.0, 2.0))
    assert list(plain.mesh.sides) == ["left", "right", "bottom", "top"]


def test_lines_of_a_grid_cannot_stay() -> None:
    with pytest.raises(em.InputError, match=r"\(0.3, 0.4\) inside stays"):
        em.BlockGrid.of(em.Blocks.rectangle(cells=(8, 8), points=[(0.3, 0.4)]))
    assert em.BlockGrid.of(em.Blocks.rectangle(cells=(8, 8))).grid == em.Grid(n_xi=9, n_eta=9)
