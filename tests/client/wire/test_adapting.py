"""The loop around a solver, without a service: what it requests, and what it takes from the answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from equimesh_client import BadArgument, BadValues, CellAverages, Certificate, ErrorIndicator, Weight
from equimesh_client.wire.adapting import AdaptLoop
from equimesh_client.wire.arrays import MeshArrays
from equimesh_coupling.parts import SIDES

NUMBER = np.arange(12).reshape(4, 3)
LINES = {"left": NUMBER[0, ::-1], "right": NUMBER[-1], "bottom": NUMBER[:, 0], "top": NUMBER[::-1, -1]}


def arrays(shift: float = 0.0) -> MeshArrays:
    """A mesh of 4 x 3 points of a square of 3 x 2, whose nodes inside are shifted along x."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij")
    x[1:-1] += shift
    corners = np.stack([NUMBER[:-1, :-1], NUMBER[1:, :-1], NUMBER[1:, 1:], NUMBER[:-1, 1:]], axis=-1)
    sides = {side: np.column_stack([LINES[side][:-1], LINES[side][1:]]) for side in SIDES}
    empty = np.zeros((3, 2))
    return MeshArrays(
        x=x, y=y, u=None, cells=corners.reshape(-1, 4), q_eq=empty, subdomain=empty.astype(np.int64), boundary=sides
    )


def certificate(l2: float, start: str | None = "lines") -> Certificate:
    compared = [{"kind": "nodal_solution", "settings": {"start": start}, "chosen": True}] if start else []
    estimate = {"l2": l2, "h1": 2 * l2, "unresolved": 0.1 * l2, "moved_cells": 3.0}
    return Certificate.from_json({"status": "completed", "estimate": estimate, "comparison": compared})


def loop(**changed: Any) -> AdaptLoop[str]:
    return AdaptLoop(**{"solve": len, "n": (4, 3), "domain": None, "rounds": 5, "norm": "l2", **changed})


def test_values_at_nodes_are_sent_with_their_nodes_and_the_certificate_is_taken_over() -> None:
    one, mesh = loop(norm="h1"), arrays()
    values = mesh.x * mesh.y
    answered = one.receive(mesh, values.ravel())
    request = one.next(answered)
    assert request is not None
    spec = request.request(((0, 3), (0, 2))).spec
    assert spec["grid"] == {"n_xi": 4, "n_eta": 3}
    assert spec["monitor"]["kind"] == "nodal_solution"
    assert spec["monitor"]["norm"] == "h1"
    assert spec["monitor"]["u"]["nodal"]["values"] == values.tolist()
    one.add("first", answered, certificate(1.0), arrays(0.1))
    one.add("second", answered, certificate(0.1, None), arrays())
    assert [record.mesh for record in one.done] == ["first", "second"]
    assert [record.estimate for record in one.done] == [1.0, 0.1]
    assert [record.start for record in one.done] == ["given", "lines"]
    assert [record.moved_cells for record in one.done] == [0.0, 3.0]
    assert (one.start, one.is_done) == ("kept", False)
    assert one.ended().best == 1


def test_an_indicator_becomes_the_weight_of_the_next_mesh() -> None:
    one = loop()
    answered = one.receive(arrays(), ErrorIndicator([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert isinstance(answered.monitor, Weight)
    request = one.next(answered)
    assert request is not None
    assert request.request(((0, 3), (0, 2))).spec["monitor"]["map"] == "gradient"
    one.add("first", answered, None, arrays(0.25))
    assert one.done[0].estimate == pytest.approx(np.sqrt(91.0))
    assert one.done[0].unresolved is None
    assert (one.start, one.moved_cells) == ("weight", pytest.approx(0.25 * np.sqrt(0.5)))


def test_an_indicator_of_zero_asks_for_no_mesh() -> None:
    one = loop()
    answered = one.receive(arrays(), ErrorIndicator(np.zeros(6)))
    assert one.next(answered) is None
    one.add("first", answered, None, None)
    assert one.is_done


@pytest.mark.parametrize("returned", [np.ones(6), np.full(12, np.nan), np.ones(5), CellAverages(np.ones(5)), "u"])
def test_values_that_cannot_be_used(returned: Any) -> None:
    with pytest.raises(BadValues):
        loop().receive(arrays(), returned)


@pytest.mark.parametrize(
    "changed", [{"rounds": 0}, {"rounds": True}, {"rounds": 101}, {"norm": "max"}, {"solve": "tanh(x)"}]
)
def test_arguments_that_cannot_be_used(changed: dict[str, Any]) -> None:
    with pytest.raises(BadArgument):
        loop(**changed)
