"""The monitor of a step: where its functions come from."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_service.problems.problem import Problem
from equimesh_service.spec.monitors import completed, functions_of, with_functions, with_u

U, V, RHO = {"samples": "u"}, {"samples": "v"}, {"expression": "1 + x"}
ARC, WEIGHT = {"kind": "arc_length", "u": U}, {"kind": "weight", "rho": RHO, "u": None}
TENSOR = {"kind": "tensor", "m11": RHO, "m12": RHO, "m22": RHO, "u": None}


def both(*members: dict[str, Any]) -> dict[str, Any]:
    return {"kind": "intersection", "monitors": list(members)}


def test_functions_are_found_where_they_are() -> None:
    monitor = both(ARC, WEIGHT)
    assert dict(functions_of(monitor)) == {"/monitor/monitors/0/u": U, "/monitor/monitors/1/rho": RHO}
    changed = with_functions(monitor, lambda pointer, source: (pointer, source))
    assert changed["monitors"][1] == {**WEIGHT, "rho": ("/monitor/monitors/1/rho", RHO)}


def test_another_u_takes_the_place_of_the_one_before() -> None:
    assert with_u(ARC, V) == {**ARC, "u": V}
    assert with_u(both(ARC, {"kind": "curvature", "u": U}, WEIGHT), V) == both(
        {**ARC, "u": V}, {"kind": "curvature", "u": V}, WEIGHT
    )


@pytest.mark.parametrize(
    ("monitor", "words"),
    [
        (WEIGHT, "the cells of a weight monitor follow rho, not u"),
        (TENSOR, "follow m11, m12, m22"),
        (both(ARC, {**ARC, "u": V}), "several functions"),
        (both(WEIGHT, WEIGHT), "several functions"),
    ],
)
def test_a_u_that_has_no_single_place_is_refused(monitor: dict[str, Any], words: str) -> None:
    with pytest.raises(Problem, match=words) as caught:
        with_u(monitor, V)
    assert caught.value.errors[0].pointer == "/u"


@pytest.mark.parametrize(
    ("monitor", "u", "before", "expected", "from_u"),
    [
        ({"norm": "h1"}, V, ARC, {"norm": "h1", "u": V}, ("/monitor/u",)),
        ({"norm": "h1"}, None, ARC, {"norm": "h1", "u": U}, ()),
        ({"kind": "curvature"}, None, both(ARC, ARC), {"kind": "curvature", "u": U}, ()),
        ({"kind": "nodal_solution"}, None, ARC, {"kind": "nodal_solution", "u": U}, ()),
        ({"kind": "curvature"}, None, both(ARC, {**ARC, "u": V}), {"kind": "curvature"}, ()),
        ({"kind": "weight", "map": "gradient"}, None, WEIGHT, {"kind": "weight", "map": "gradient", "rho": RHO}, ()),
        ({"kind": "weight", "rho": V}, U, ARC, {"kind": "weight", "rho": V, "u": U}, ("/monitor/u",)),
        (
            both({"u": V}, {"kind": "curvature"}, WEIGHT),
            U,
            ARC,
            both({"u": V}, {"kind": "curvature", "u": U}, WEIGHT),
            ("/monitor/monitors/1/u",),
        ),
        (both(WEIGHT, TENSOR), U, ARC, both({**WEIGHT, "u": U}, TENSOR), ("/monitor/monitors/0/u",)),
        (both({"u": V}), None, ARC, both({"u": V}), ()),
    ],
)
def test_functions_that_a_new_monitor_lacks(
    monitor: dict[str, Any], u: Any, before: dict[str, Any], expected: dict[str, Any], from_u: tuple[str, ...]
) -> None:
    assert completed(monitor, u, before) == (expected, from_u)


@pytest.mark.parametrize("monitor", [{"u": U}, both({"u": U}, {"u": V}), both({"u": U}, WEIGHT)])
def test_a_u_that_nothing_needs_is_refused(monitor: dict[str, Any]) -> None:
    with pytest.raises(Problem, match="u is not used"):
        completed(monitor, V, ARC)
