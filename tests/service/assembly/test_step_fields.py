"""Fields of a step: checked against a mesh, and written to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh_service.assembly.bodies import StepField, checked_values, read_fields, write_fields
from service.requests import STEP

MESH = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
NODES, CELLS = np.arange(20.0).reshape(5, 4), np.arange(12.0).reshape(4, 3)
BAD = NODES.copy()
BAD[2, 3] = np.nan


@pytest.mark.parametrize(
    ("values", "location", "words"),
    [
        (BAD, "nodes", r"p\[2\]\[3\] is NaN \(1 of 20 values are not finite\), as from a solver that diverged"),
        (NODES.T, "nodes", "transpose it"),
        (NODES[:3], "nodes", r"shape \(3, 4\), but the mesh has 5 x 4 nodes"),
        (CELLS, "nodes", "one value for each of the cells, and is sent as nodes: give it the location cells"),
        (NODES, "cells", "one value for each of the nodes, and is sent as cells: give it the location nodes"),
        (NODES.ravel(), "nodes", "2 dimensions, not 1"),
        (np.ones((5, 4, 17)), "nodes", "vectors of 17 components"),
        (1e200 * NODES, "nodes", r"p\[0\]\[1\] = 1e\+200"),
        ([[1.0, 2.0], [3.0]], "nodes", "the same length"),
    ],
)
def test_values_that_do_not_belong_to_the_mesh(values: Any, location: Any, words: str) -> None:
    with pytest.raises(SamplesError, match=words):
        StepField(values=values, transfer="conservative", location=location).checked(MESH, "p")


def test_averages_have_no_spline() -> None:
    with pytest.raises(SamplesError, match="p has averages of cells, which have no spline"):
        StepField(values=CELLS, location="cells").checked(MESH, "p")


@pytest.mark.parametrize(
    ("transfer", "bounds", "words"),
    [
        ("spline", (0.0, 20.0), "only the conservative transfer keeps bounds"),
        ("conservative", (0.0, 1.0), "p lies between 0 and 19, its bounds are 0 and 1"),
        ("conservative", (1.0, 0.0), "the least and the largest value"),
    ],
)
def test_bounds_that_do_not_hold(transfer: Any, bounds: tuple[float, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        StepField(values=NODES, transfer=transfer, bounds=bounds).checked(MESH, "p")


def test_what_is_right_stays_as_it_is() -> None:
    for values in (NODES, NODES.tolist(), np.stack([NODES, -NODES], axis=-1), [[[1, 2]] * 4] * 5):
        np.testing.assert_array_equal(checked_values(values, MESH, "p"), values)


def test_fields_are_read_as_they_were_written(tmp_path: Path) -> None:
    fields = {
        "p": StepField(values=NODES),
        "q": StepField(values=CELLS, transfer="conservative", location="cells", bounds=(-1.0, 20.0)),
        "v": StepField(values=np.stack([NODES, NODES], axis=-1), transfer="conservative"),
    }
    write_fields(tmp_path / "fields.npz", fields)
    found = read_fields(tmp_path / "fields.npz")
    assert [*found] == [*fields]
    for name, field in fields.items():
        assert found[name].settings == field.settings
        np.testing.assert_array_equal(found[name].values, field.values)


def test_usual_fields_are_written_as_in_the_release_before(tmp_path: Path) -> None:
    write_fields(tmp_path / "fields.npz", {"p": StepField(values=NODES)})
    np.savez(tmp_path / "before.npz", p=NODES)
    assert (tmp_path / "fields.npz").read_bytes() == (tmp_path / "before.npz").read_bytes()


def test_values_on_blocks_are_rows_of_one_number_or_plain_arrays() -> None:
    mesh = em.Blocks.of(STEP).mesh
    u, vectors = mesh.x, mesh.points
    for given in (u, u[:, None], u[:, None].tolist()):
        np.testing.assert_array_equal(checked_values(given, mesh, "u", vectors=False), u)
    for given in (vectors, vectors[:, None], vectors[:, None].tolist()):
        np.testing.assert_array_equal(checked_values(given, mesh, "v"), vectors)
    with pytest.raises(em.SamplesError, match="one number"):
        checked_values(vectors, mesh, "u", vectors=False)
    with pytest.raises(em.SamplesError, match="as many as the cells"):
        checked_values(np.ones(len(mesh.cells)), mesh, "u")
    with pytest.raises(em.SamplesError, match="rescale"):
        checked_values(np.full(len(u), 1e300), mesh, "u")
