"""Nested dissection: an order of all unknowns."""

from __future__ import annotations

from equimesh.numerics import newton


def test_nested_dissection_orders_every_unknown_once() -> None:
    order = newton.elimination_order((13, 37))
    assert sorted(order) == list(range(2 * 13 * 37))
    assert (order[1::2] - order[::2] == 13 * 37).all()
