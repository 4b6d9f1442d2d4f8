"""Settings of the Schwarz iteration between blocks: subdomains, and what is refused."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.subdomains import owners
from equimesh.meshes.mesh import Mesh, quads_of_block
from equimesh.testing.geometries import l_shape

ROW = np.arange(4 * 3).reshape(4, 3)


def row_of_blocks() -> Mesh:
    """Three blocks in a row, of one column of two cells each; cells are in another order than blocks."""
    blocks = tuple(ROW[k : k + 2] for k in (2, 0, 1))
    points = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij"), axis=-1).reshape(-1, 2)
    return Mesh(points=points, cells=quads_of_block(ROW), sides={}, blocks=blocks, block_names=("c", "a", "b"))


def test_each_block_is_a_subdomain_unless_groups_say_otherwise() -> None:
    mesh = row_of_blocks()
    assert owners(em.Schwarz(), mesh).tolist() == [1, 1, 2, 2, 0, 0]
    for groups in ([["a", "c"], ["b"]], (("a", 0), (2,))):
        assert owners(em.Schwarz(groups=groups), mesh).tolist() == [0, 0, 1, 1, 0, 0]


@pytest.mark.parametrize(
    ("groups", "field", "words"),
    [
        ([["a", "b"]], "schwarz.groups", "the block c is in no group"),
        ([["a", "b"], ["c", 1]], "schwarz.groups", "the block a is in two groups"),
        ([["a", "b"], ["d"]], "schwarz.groups[1]", "no block d: the blocks are c, a, b"),
        ([["a", "b"], [3]], "schwarz.groups[1]", "no block 3"),
        ([["a", "b"], [True]], "schwarz.groups[1]", "no block True"),
    ],
)
def test_groups_that_are_no_partition_are_refused(groups: Any, field: str, words: str) -> None:
    with pytest.raises(em.InputError, match=words) as caught:
        owners(em.Schwarz(groups=groups), row_of_blocks())
    assert caught.value.field == field


@pytest.mark.parametrize("name", ["overlap", "local_steps", "max_exchanges"])
@pytest.mark.parametrize("value", [0, 2.0, True, "4", 10**6])
def test_numbers_of_the_wrong_kind_are_refused(name: str, value: Any) -> None:
    with pytest.raises(em.InputError, match=f"{name} = ") as caught:
        em.Schwarz(**{name: value}).require_blocks()
    assert caught.value.field == f"schwarz.{name}"


@pytest.mark.parametrize("groups", [[], "ab", [[]], ["a", "b"]])
def test_groups_of_the_wrong_kind_are_refused(groups: Any) -> None:
    with pytest.raises(em.InputError, match="a list of groups"):
        em.Schwarz(groups=groups)


def test_exchanges_take_the_steps_of_the_whole_mesh_unless_a_number_is_given() -> None:
    assert [em.Schwarz().exchanges(steps) for steps in (1, 8, 9, 30)] == [1, 1, 2, 4]
    assert em.Schwarz(max_exchanges=3).exchanges(30) == 3


OF_GRIDS: dict[str, Any] = {
    "subdomains": (2, 2),
    "transmission": em.Classical(),
    "ordering": "alternating",
    "line_correction": 1,
    "acceleration": "none",
    "local_solver": "newton",
    "fallback": False,
    "tolerance": 1e-6,
    "max_iterations": 5,
    "compare_single_domain": True,
}
OF_BLOCKS: dict[str, Any] = {"local_steps": 4, "max_exchanges": 3, "groups": [["a", "b"]]}


def test_each_setting_belongs_to_grids_or_to_blocks_or_to_both() -> None:
    assert {*OF_GRIDS, *OF_BLOCKS, "overlap"} == {one.name for one in fields(em.Schwarz)}


@pytest.mark.parametrize("name", OF_GRIDS)
def test_settings_of_grids_are_refused_on_blocks(name: str) -> None:
    problem = em.Problem(monitor=em.LeastError(u=em.Expression("tanh(9*x)")), domain=l_shape(100))
    with pytest.raises(em.InputError, match=f"^{name} is one of .* leave it out, and group blocks") as caught:
        em.solve(problem, em.Schwarz(**{name: OF_GRIDS[name]}))
    assert caught.value.field == f"schwarz.{name}"


@pytest.mark.parametrize("name", OF_BLOCKS)
def test_settings_of_a_descent_are_refused_where_grids_are_equidistributed(name: str) -> None:
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(9*x)")), grid=em.Grid(n_xi=9, n_eta=9))
    with pytest.raises(em.InputError, match=f"^{name} is one of the settings of (blocks|least error)") as caught:
        em.solve(problem, em.Schwarz(**{name: OF_BLOCKS[name]}))
    assert caught.value.field == f"schwarz.{name}"
