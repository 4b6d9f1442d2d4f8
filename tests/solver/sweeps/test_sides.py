"""Nodes on the sides of the domain."""

from __future__ import annotations

import numpy as np

import equimesh as em
from cases import problem
from equimesh.single_domain import iteration
from equimesh.sweeps.sweep import WHOLE, Frame, SideNodes


def test_the_sides_move_with_the_interior() -> None:
    """Nodes on the sides go where the equations of the sides want them, also at right angles to a moving interior."""
    for boundary in em.Boundary:
        case = problem("tanh20", 33, boundary=boundary, b=0.5)
        *_, last = iteration.single_domain_steps(case)
        equations = case.equations()
        assert abs(equations.residual(equations.vector(last.mesh))).max() < 1e-9 * equations.mean_flux(
            equations.vector(last.mesh)
        )
        assert abs(last.mesh.x[:, 0] - np.linspace(0, 1, 33)).max() > 1e-3


# Frames: where the lines of a window begin and end.


def test_lines_end_one_node_before_a_side_that_yields() -> None:
    frame = Frame(physical=((False, True), (False, False)), beyond=((7.0, 0.0), (0.0, 3.0)))
    assert frame.span(0, 12) == (1, 11)
    assert frame.span(1, 9) == (0, 7)


def test_the_lines_of_the_whole_grid_are_whole() -> None:
    assert WHOLE.physical == ((True, True), (True, True))
    assert (WHOLE.span(0, 12), WHOLE.span(1, 9)) == ((0, 11), (0, 8))


# The nodes along the sides, in full.


SHAPE = (130, 2049)
X, Y = np.random.default_rng(5).random((2, *SHAPE))


def test_moved_sides_are_new_ones() -> None:
    whole = SideNodes.of(X, Y)
    moved = whole.moved(whole.along_eta, -whole.along_xi)
    assert np.array_equal(moved.along_eta, 2 * Y[[0, -1]])
    assert not moved.along_xi.any()
