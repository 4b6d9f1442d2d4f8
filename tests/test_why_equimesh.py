"""The page that compares us with other programs: its tables are those of the record, and the measures are right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import made_meshes
import movers
import numpy as np
import pytest
import remeshers
import why_equimesh

import equimesh as em

U = em.Expression("exp(-50*((x - 0.4)**2 + (y - 0.6)**2))")


def test_the_tables_of_the_page_are_those_of_the_record() -> None:
    record = why_equimesh.recorded(why_equimesh.POINTS)
    table = why_equimesh.PAGE.read_text().partition(why_equimesh.BEGIN)[2].partition(why_equimesh.END)[0]
    assert table.strip() == "\n".join(why_equimesh.tables(record))
    assert {*why_equimesh.FUNCTIONS} == {*record["meshes"]}


def test_claims_of_the_page_are_those_of_the_record() -> None:
    meshes = why_equimesh.recorded(why_equimesh.POINTS)["meshes"]
    for name, found in meshes.items():
        gradient = {mesher: one["h1"] for mesher, one in found.items()}
        assert (min(gradient, key=lambda mesher: gradient[mesher]) == "equimesh, `least_error`, norm `h1`") == (
            name != "tanh60"
        )
        assert found["equimesh, `least_error`"]["l2"] <= found["equimesh, `weight`, gradient map"]["l2"]
        assert all(one["folded"] == 0 and one["sides_kept"] == 4 for one in found.values())
    front = meshes["tanh60"]
    assert front["Mmg2d"]["l2"] < 0.6 * front["equimesh, `auto` for `interpolation`"]["l2"]


def test_the_uniform_mesh_has_the_errors_of_the_uniform_mesh() -> None:
    made = replace(made_meshes.uniform(9), seconds=0.5)
    found = made_meshes.measure(made, U, 9)
    assert (found.l2, found.h1, found.rate) == (1.0, 1.0, 162.0)
    assert (found.smallest_angle, found.largest_angle) == pytest.approx((90.0, 90.0))
    assert (found.folded, found.sides_kept) == (0, 4)
    triangles = made_meshes.measure(replace(made, cells=made_meshes.split(made.cells)), U, 9)
    assert (triangles.smallest_angle, triangles.largest_angle) == pytest.approx((45.0, 90.0))
    assert triangles.l2 > 1.0


def test_folded_cells_and_lost_tags_are_counted() -> None:
    made = made_meshes.uniform(5)
    points = made.points.copy()
    points[12] = 0.9, 0.5  # the node in the middle, moved over its neighbour
    assert made_meshes.measure(replace(made, points=points, seconds=1.0), U, 5).folded == 2
    assert made_meshes.sides_kept(replace(made, tags=np.where(made.tags == made_meshes.TOP, 7, made.tags))) == 3
    assert made_meshes.sides_kept(replace(made, edges=made.edges[1:], tags=made.tags[1:])) == 3
    assert made_meshes.sides_kept(replace(made, tags=made.tags[::-1])) == 0


def test_the_scale_is_sought_until_the_vertices_are_as_many() -> None:
    def make(scale: float) -> made_meshes.Made:
        return made_meshes.uniform(max(2, round(scale**0.5)))

    assert len(made_meshes.with_vertices(make, 33).points) == pytest.approx(33**2, rel=0.03)


def test_our_own_row_is_our_mesh() -> None:
    found = made_meshes.measure(movers.own("`arc_length`", U, 9), U, 9)
    solution = em.solve(em.Problem(monitor=em.ArcLength(u=U), grid=em.Grid(n_xi=9, n_eta=9)))
    assert found.l2 == pytest.approx(1.0 / solution.interpolation.gain_l2, rel=0.02)
    assert found.sides_kept == 4


def test_targets_have_their_long_edges_along_the_direction() -> None:
    long = np.array([[1.0, 0.0], [0.0, 1.0], [np.cos(0.3), np.sin(0.3)]])
    angles, ratios = movers._edges(long, np.array([4.0, 4.0, 2.0]))
    assert angles == pytest.approx([0.0, 0.0, 0.3], abs=1e-12)
    assert ratios == pytest.approx([0.25, 4.0, 0.5])


def test_a_file_of_freefem_is_read(tmp_path: Path) -> None:
    path = tmp_path / "mesh.msh"
    path.write_text("3 1 3\n0 0 1\n1 0 1\n0 1 4\n1 2 3 0\n1 2 1\n2 3 9\n3 1 4\n")
    points, cells, edges, tags = remeshers.read_msh(path)
    assert points.tolist() == [[0, 0], [1, 0], [0, 1]]
    assert (cells.tolist(), edges.tolist()) == ([[0, 1, 2]], [[0, 1], [1, 2], [2, 0]])
    assert tags.tolist() == [made_meshes.BOTTOM, 0, made_meshes.LEFT]


def test_a_measurement_replaces_an_older_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(why_equimesh, "RECORD", tmp_path / "record.json")
    monkeypatch.setattr(why_equimesh, "versions", lambda: {"Python": "Python 3"})
    found = made_meshes.measure(replace(made_meshes.uniform(9), seconds=1.0), U, 9)
    for l2 in (0.5, 0.25):
        why_equimesh.remember("ring", "Mmg2d", replace(found, l2=l2), 9)
    record = why_equimesh.recorded(9)
    assert record["meshes"]["ring"]["Mmg2d"]["l2"] == 0.25
    assert [*why_equimesh.tables(record)][-1] == "| Mmg2d | 0.25, 1 | 81 | 90.0 to 90.0 |"
    assert why_equimesh.recorded(17)["meshes"] == {}
