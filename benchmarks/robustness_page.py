"""The section on robustness of docs/background/benchmarks.md, from the results of benchmarks/robustness.py.

These are in benchmarks/robustness.json.

python benchmarks/robustness_page.py writes the section.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import robustness_ways
from functions import FUNCTIONS

Result: TypeAlias = dict[str, Any]

ROOT = Path(__file__).resolve().parent.parent
DATA, PAGE = ROOT / "benchmarks" / "robustness.json", ROOT / "docs" / "background" / "benchmarks.md"
BEGIN, END = "<!-- robustness: begin -->", "<!-- robustness: end -->"
SUCCEEDED = ("converged", "relaxed")
MILD_B, LIGHT = 0.05, 0.03

INTRODUCTION = """
{functions} functions, from mild to hostile, {settings} settings of `a` and `b`, grids of {points} points a side:
{cells} solves with otherwise default settings.
"""

HONESTY = """
"`a` reached" allows a [cross-line term](../how-to/relaxed.md#what-a-weight-costs), which makes lines straighter: a
weight of 0.01 costs a few percent of the gain, 0.1 up to 40 %, 3 often most of it. What was relaxed, in numbers of
solves: {relaxed}.
"""


def reached(result: Result) -> bool:
    """Whether the mesh is valid, on its own grid, and adapted with the requested a."""
    return result.get("status") in SUCCEEDED and not {"a", "points"} & result["relaxed"].keys()


def exact(result: Result) -> bool:
    """Whether the mesh satisfies the requested equations."""
    return result.get("status") == "converged"


def lightly(result: Result) -> bool:
    """Whether the requested a is reached with a light cross-line term, or none."""
    return reached(result) and result["relaxed"].get("cross_line", 0.0) <= LIGHT


def gains(result: Result) -> bool:
    """Whether the mesh interpolates u better than the uniform one."""
    return (result.get("gain") or 0.0) > 1.0


def render(results: Sequence[Result]) -> str:
    """The text of the section."""
    points = sorted({result["n"] for result in results})
    settings = {(result["a"], result["b"]) for result in results}
    functions = {result["name"] for result in results}
    listed = ", ".join(map(str, points[:-1])) + f" and {points[-1]}" if points[1:] else str(points[0])
    head = INTRODUCTION.format(functions=len(functions), settings=len(settings), points=listed, cells=len(results))
    lines = [head, *_summary(results), HONESTY.format(relaxed=_relaxations(results))]
    ways = robustness_ways.read()
    return "\n".join([*lines, *(robustness_ways.section(ways) if ways else ())]) + "\n"


def shown() -> str:
    """The section in the page."""
    return PAGE.read_text().partition(f"{BEGIN}\n")[2].partition(f"\n{END}")[0]


def _summary(results: Sequence[Result]) -> Iterator[str]:
    mild = [result for result in results if result["b"] >= MILD_B]
    folded = sum(bool(r.get("folded")) for r in results)
    failed = sum("exception" in r for r in results)
    invalid = sum(r.get("status") not in SUCCEEDED for r in results)
    yield f"Folded meshes: {folded}. Exceptions: {failed}. Solves without a valid mesh: {invalid}.\n"
    yield f"| | b >= {MILD_B:g} | all |"
    yield "|---|---|---|"
    rows = (
        ("requested `a` reached", reached),
        (f"the same, with a cross-line weight of at most {LIGHT:g}", lightly),
        ("requested equations satisfied, without any relaxation", exact),
        ("u interpolated better than on the uniform mesh", gains),
    )
    for what, holds in rows:
        yield f"| {what} | {_share(holds, mild)} | {_share(holds, results)} |"


def _share(holds: Callable[[Result], bool], results: Sequence[Result]) -> str:
    return f"{100 * sum(map(holds, results)) / max(len(results), 1):.1f} %"


def _need(result: Result) -> str:
    """The relaxation of a result, in a word."""
    relaxed = result.get("relaxed", {})
    if result.get("status") not in SUCCEEDED:
        return "no mesh"
    if "points" in relaxed:
        return "coarser grid"
    if "a" in relaxed:
        return "less a"
    return f"cross-line {relaxed['cross_line']:g}" if relaxed else "nothing"


def _relaxations(results: Sequence[Result]) -> str:
    """Every relaxation with its number of solves, from none to the strongest."""
    needs = [_need(result) for result in results]
    weights = sorted({need for need in needs if need.startswith("cross-line")}, key=lambda need: float(need.split()[1]))
    kinds = ["nothing", *weights, "less a", "coarser grid", "no mesh"]
    return ", ".join(f"{kind.replace('less a', 'less `a`')} {needs.count(kind)}" for kind in kinds)


def read() -> list[Result]:
    """The stored results."""
    results: list[Result] = json.loads(DATA.read_text())
    return results


def write(results: Sequence[Result]) -> None:
    """Store the results, sorted, one a line, and write the section of the page."""
    names = list(FUNCTIONS)
    key = [(-r["b"], r["a"], names.index(r["name"]), r["n"]) for r in results]
    ordered = [results[k] for k in sorted(range(len(results)), key=key.__getitem__)]
    DATA.write_text("[\n" + ",\n".join(map(json.dumps, ordered)) + "\n]\n")
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{render(ordered)}\n{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    write(read())
