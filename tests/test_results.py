"""The page of results: its tables are those of the code, and each claim has its command."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import results

PAGE = results.PAGE.read_text()
RATE = 2e-3
"""Accepted difference of a printed rate, which rounding can change."""


def rows(part: str) -> list[list[str]]:
    """The rows of a table of the page, without the line below its head."""
    begin, end = results.marks(part)
    found = PAGE.partition(begin)[2].partition(end)[0].strip().splitlines()
    assert found, part
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in found if not line.startswith("|---")]


def computed(table: Iterator[Sequence[object]]) -> list[list[str]]:
    return [[str(cell) for cell in row] for row in table]


def columns(part: str, kept: list[int]) -> list[list[str]]:
    """Some columns of a table of the page."""
    return [[row[column] for column in kept] for row in rows(part)]


@pytest.mark.parametrize("part", results.PARTS)
def test_every_table_has_its_command(part: str) -> None:
    assert re.search(rf"^```shell\npython benchmarks/results.py {part}\n```$", PAGE, re.MULTILINE)
    assert len({len(row) for row in rows(part)}) == 1


def test_jacobians_of_both_boundary_conditions_are_those_of_the_page() -> None:
    found = computed(results.trace(["tanh20"], [17, 33]))
    assert found == [row for row in columns("trace", [0, 1, 2, 3]) if row[0] in ("u", "`tanh20`")]


def test_the_page_shows_that_trace_converges_and_the_paper_s_condition_does_not() -> None:
    for u, boundary, *jacobians in rows("trace")[1:]:
        assert ("none" in jacobians) == (boundary == "`equidistributed_1d`"), u


def test_the_automatic_parameter_needs_the_fewest_iterations() -> None:
    assert computed(results.robin([2.0, None])) == columns("p", [0, 2, 3])
    for kind, *iterations in rows("p")[1:3]:
        assert min(iterations, key=int) == iterations[2], kind


def test_rates_of_two_strips_are_those_of_the_page() -> None:
    found, printed = computed(results.sums([2])), [row for row in rows("sums") if row[1] in ("strips", "2")]
    assert [(row[0], row[1], row[2], row[4]) for row in found] == [(*row[:3], row[4]) for row in printed]
    for one, other in zip(found[1:], printed[1:], strict=True):
        assert float(one[3]) == pytest.approx(float(other[3]), abs=RATE)


def test_line_sums_take_as_many_iterations_with_more_strips() -> None:
    taken = [row[4] for row in rows("sums") if row[0].startswith("line sums")]
    assert len({*taken}) == 1
    assert len(taken) == len(results.STRIPS)


def test_the_mesh_of_a_partition_is_that_of_the_page() -> None:
    found, printed = computed(results.cuts(["paper"], [(2, 1)])), rows("cuts")
    assert found[1] == printed[1]  # threads: equal to the last bit
    (same,) = (row for row in printed if row[:2] == ["`paper`", "2 x 1"])
    assert (found[2][2], found[2][4]) == (same[2], same[4])
    assert all(float(row[3]) <= 1e-10 for row in [*found[1:], *printed[1:]])


def test_no_mesh_of_least_error_is_worse_than_the_uniform_one() -> None:
    for row in [*computed(results.least(2, 17))[1:], *rows("least")[1:]]:
        assert float(row[2]) >= 1.0
        assert row[5] == "0"
    assert [row[1] for row in rows("least")[1:]] == [str(results.COUNT)] * 2


def test_an_observed_rate_is_the_mean_factor_of_the_last_errors() -> None:
    assert results.observed_rate([1.0, 0.5, 0.25, 1e-10]) == "0.500"
    assert results.observed_rate([64.0, 1.0, 0.1, 1e-2, 1e-3, 1e-4]) == "0.100"


def test_a_table_is_put_between_its_marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    begin, end = results.marks("p")
    page.write_text(f"before\n\n{begin}\nold\n{end}\n\nafter\n")
    monkeypatch.setattr(results, "PAGE", page)
    results.write("p", ["| a |", "|---|"])
    assert page.read_text() == f"before\n\n{begin}\n\n| a |\n|---|\n\n{end}\n\nafter\n"
    with pytest.raises(SystemExit):
        results.write("sums", [])
