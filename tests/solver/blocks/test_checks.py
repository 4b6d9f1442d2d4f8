"""Curves that cross themselves, and initial meshes that fold."""

from __future__ import annotations

import re
from typing import Any

import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.blocks.checks import check_not_crossing
from equimesh.blocks.curve_entries import Airfoil
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


def around(third: float) -> dict[str, Any]:
    """Blocks that go around in a spiral: the last one ends at the height ``third``, the first one begins at 0 to 1."""
    places = {"a": (0, 0), "b": (3, 0), "c": (3, 3), "d": (0, 3), "i": (1, 1), "j": (2, 1), "k": (2, 2), "l": (1, 2)}
    corners = [["a", "b", "j", "i"], ["b", "c", "k", "j"], ["c", "d", "l", "k"], ["d", "e", "f", "l"]]
    return {
        "vertices": {name: list(place) for name, place in places.items()} | {"e": [0, third], "f": [1, third]},
        "blocks": [{"name": f"part{k}", "corners": names, "cells": [2, 2]} for k, names in enumerate(corners)],
    }


def test_blocks_that_overlap_are_named_with_their_edges_and_the_place() -> None:
    assert Blocks.of(around(1.5)).mesh.cell_areas().sum() == pytest.approx(7.0)
    with pytest.raises(em.InputError, match=r"part3 and part0 overlap near|part0 and part3 overlap near") as caught:
        Blocks.of(around(0.5))
    words = str(caught.value)
    x, y = map(float, re.findall(r"near \(([-\d.e]+), ([-\d.e]+)\)", words)[0])
    assert 0 <= x <= 1
    assert 0 <= y <= 1
    assert re.search(r"at the boundary (i-a|a-i|i-j|j-i|a-b) and (\w-\w); move their vertices", words)
    assert caught.value.field == "domain.blocks[3]"


def test_a_block_inside_of_another_one_is_named() -> None:
    document = {
        "vertices": {
            "a": [0, 0],
            "b": [10, 4],
            "c": [10, 5],
            "d": [0, 9],
            "p": [3, 4],
            "q": [4, 4],
            "r": [4, 5],
            "s": [3, 5],
        },
        "blocks": [
            {"name": "large", "corners": ["a", "b", "c", "d"], "cells": [8, 8]},
            {"name": "small", "corners": ["p", "q", "r", "s"], "cells": [1, 8]},
        ],
        "joins": [{"from": ["p", "s"], "to": ["b", "c"]}],
    }
    with pytest.raises(em.InputError, match=r"small and large overlap near \(.*\): ") as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.blocks[1]"


def test_blocks_that_are_not_connected_are_named() -> None:
    document = {
        "vertices": {f"v{i}{j}": [i, j] for i in range(4) for j in range(3)},
        "blocks": [
            {"corners": ["v00", "v10", "v11", "v01"], "cells": [2, 2]},
            {"corners": ["v11", "v21", "v22", "v12"], "cells": [2, 2]},
        ],
    }
    used = {name for block in document["blocks"] for name in block["corners"]}
    document["vertices"] = {name: at for name, at in document["vertices"].items() if name in used}
    match = "block1 is not connected with block0: no edge leads to it, so give v11-v12 or v21-v22 or v11-v21 or v12-v22"
    with pytest.raises(em.InputError, match=match) as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.blocks[1]"
    joined = document | {"joins": [{"from": ["v00", "v01"], "to": ["v21", "v22"]}]}
    assert len(Blocks.of(joined).mesh.blocks) == 2
