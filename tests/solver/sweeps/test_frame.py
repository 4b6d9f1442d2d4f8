"""Frames: where the lines of a window begin and end."""

from __future__ import annotations

from equimesh.sweeps.sides import WHOLE, Frame


def test_lines_end_one_node_before_a_side_that_yields() -> None:
    frame = Frame(physical=((False, True), (False, False)), beyond=((7.0, 0.0), (0.0, 3.0)))
    assert frame.span(0, 12) == (1, 11)
    assert frame.span(1, 9) == (0, 7)


def test_the_lines_of_the_whole_grid_are_whole() -> None:
    assert WHOLE.physical == ((True, True), (True, True))
    assert (WHOLE.span(0, 12), WHOLE.span(1, 9)) == ((0, 11), (0, 8))
