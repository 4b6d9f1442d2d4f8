"""Robustness: no folded mesh, all of the asked a on small grids, and a page that says what its data say."""

from __future__ import annotations

from typing import Any

import pytest
import robustness
import robustness_page as page

CELLS = [
    (name, a, b, n)
    for n, a, b in ((17, 0.7, 0.05), (17, 1.0, 0.0), (33, 0.7, 0.05))
    for name in ("paper", "tanh60", "diag100", "gauss", "wave", "cross", "cornerlayer", "twopeaks")
    if (name, b) not in {("wave", 0.0), ("cornerlayer", 0.0)}  # less of a is reached there
]


@pytest.mark.parametrize(("name", "a", "b", "n"), CELLS)
def test_a_cell_reaches_the_asked_a_without_a_fold(name: str, a: float, b: float, n: int) -> None:
    result: dict[str, Any] = robustness.run(robustness.Cell(name, a, b, n))
    assert "exception" not in result
    assert not result["folded"]
    assert result["jacobian"] > 0
    assert page.reached(result)
    assert (result["status"] == "relaxed") == bool(result["relaxed"]), "status and certificate disagree"
    if result["status"] == "converged":
        assert result["residual"] < 0.1, "the asked equations are satisfied"


def test_an_exception_is_a_result() -> None:
    result = robustness.run(robustness.Cell("paper", 2.0, 0.05, 17))
    assert result["exception"].startswith("InputError: a = 2.0")


def test_the_page_is_that_of_its_data() -> None:
    assert page.shown() == page.render(page.read()), "write it with benchmarks/robustness_page.py"


def test_no_cell_folded_and_hardly_one_fell_short() -> None:
    results = page.read()
    assert len({result["name"] for result in results}) >= 24
    assert not any("exception" in result or result["folded"] for result in results)
    mild = [result for result in results if result["b"] >= 0.05]
    assert sum(map(page.reached, mild)) >= 0.95 * len(mild)
    assert sum(map(page.reached, results)) >= 0.85 * len(results)


def test_the_summary_counts() -> None:
    """By hand: of four cells one is exact, one light, one heavy, one short of a."""
    common = {"name": "paper", "a": 1.0, "n": 33, "cpu": 1.0, "steps": 1, "residual": 0.1, "jacobian": 0.5}
    common |= {"folded": False, "q_eq": 2.0, "gain": 0.5}
    kinds: list[dict[str, float]] = [{}, {"cross_line": 0.01}, {"cross_line": 3.0}, {"a": 0.5, "cross_line": 3.0}]
    results = [
        common | {"b": b, "relaxed": relaxed, "status": "relaxed" if relaxed else "converged"}
        for relaxed, b in zip(kinds, (0.05, 0.05, 0.0, 0.0), strict=True)
    ]
    text = page.render(results)
    assert "| requested `a` reached | 100.0 % | 75.0 % |" in text
    assert "at most 0.03 | 100.0 % | 50.0 % |" in text
    assert "any relaxation | 50.0 % | 25.0 % |" in text
    assert "nothing 1, cross-line 0.01 1, cross-line 3 1, less `a` 1, coarser grid 0, no mesh 0." in text
    results[1] |= {"folded": True, "status": "folded"}
    assert "Folded meshes: 1." in page.render(results)
