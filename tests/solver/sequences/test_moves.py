"""How far the nodes of a mesh move."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.sequences.pursuit import cells_moved, displacement, largest_jump, stays_valid
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import corner, disc, turned


def test_moves_are_counted_in_cells() -> None:
    old = em.Mesh.uniform(em.Grid(n_xi=21, n_eta=11))
    new = em.Mesh(old.x + 0.1, old.y - 0.05)
    assert cells_moved(old, new) == pytest.approx(2.0)
    assert displacement(old, new)[3, 4].tolist() == pytest.approx([0.1, -0.05])
    few = old.x.copy()
    few[7, 3] += 0.3  # one node is no front
    assert cells_moved(old, em.Mesh(few, old.y)) < 0.01


def test_a_way_on_which_a_cell_folds_is_seen() -> None:
    old = smooth_mesh(9)
    assert stays_valid(old, smooth_mesh(9, depth=-0.08))
    turned = em.Mesh(-old.x, -old.y)  # a half turn: valid at both ends, and flat in the middle
    assert not turned.is_folded
    assert not stays_valid(old, turned)


def test_the_largest_jump_is_a_share_of_the_range() -> None:
    cells = em.Mesh(*np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij")).cells
    assert largest_jump(np.array([[0.0, 0.1], [0.5, 2.0]]), cells) == pytest.approx(1.9 / 2.0)
    assert largest_jump(np.ones((2, 2)), cells) == 0.0


def test_moves_on_blocks_count_in_cells_too() -> None:
    mesh = corner(4)
    far = mesh.moved(mesh.points + np.array([0.125, 0.0]))
    assert cells_moved(mesh, far) == pytest.approx(0.5)
    assert displacement(mesh, far).shape == (len(mesh.points), 2)
    assert stays_valid(mesh, far)
    assert largest_jump(mesh.x, mesh.cells) == pytest.approx(0.125)
    assert largest_jump(0 * mesh.x, mesh.cells) == 0.0


def test_cells_of_blocks_that_fold_on_the_way_are_found() -> None:
    mesh = disc(4)
    assert stays_valid(mesh, turned(mesh, 0.5))
    assert not stays_valid(mesh, turned(mesh, np.pi))  # both ends are valid, and half way all nodes meet
