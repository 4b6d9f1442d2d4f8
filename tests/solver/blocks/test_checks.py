"""Curves that cross themselves, and initial meshes that fold."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.blocks.airfoil import Airfoil
from equimesh.blocks.blocks import Blocks
from equimesh.blocks.checks import check_not_crossing
from equimesh.blocks.curves import Circle
from equimesh.blocks.spline_curve import SplineCurve
from solver.blocks import documents


@pytest.mark.parametrize("curve", [Circle(), Airfoil(digits="0012"), Airfoil(digits="6409")], ids=str)
def test_closed_curves_touch_at_their_begin_only(curve: Circle | Airfoil) -> None:
    check_not_crossing(curve, "curves.foil", "domain.curves.foil")


def test_a_crossing_is_refused_with_its_place() -> None:
    eight = ((0.0, 0.0), (1.0, 1.0), (2.0, 0.0), (1.0, -1.0), (0.0, 1.0), (-0.5, 0.5), (0.0, 0.0))
    with pytest.raises(em.InputError, match=r"curves.foil crosses itself near \(0\.\d+, 0\.\d+\), at t = ") as caught:
        check_not_crossing(SplineCurve(points=eight, closed=True), "curves.foil", "domain.curves.foil")
    assert caught.value.field == "domain.curves.foil"


def test_a_block_that_folds_is_named_with_its_place() -> None:
    document = documents.l_shape()
    document["vertices"]["e"] = [-0.5, 0.2]
    with pytest.raises(em.InputError, match=r"block0 folds at \(.*\), in its cell \(\d, \d\) of 4 x 5: move") as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.blocks[0]"


def test_a_block_that_is_inside_out_is_named() -> None:
    document = {
        "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
        "blocks": [{"corners": ["a", "d", "c", "b"], "cells": [3, 3]}],
    }
    with pytest.raises(em.InputError, match="block0 is inside out: list its corners counter-clockwise"):
        Blocks.of(document)
