"""The page docs/background/robustness.md from the results of benchmarks/robustness.py.

These are in benchmarks/robustness.json.

python benchmarks/robustness_page.py writes the page.
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
DATA, PAGE = ROOT / "benchmarks" / "robustness.json", ROOT / "docs" / "background" / "robustness.md"
SUCCEEDED = ("converged", "relaxed")
MILD_B, LIGHT = 0.05, 0.03
WORST = 12

INTRODUCTION = """\
# Robustness

{functions} functions, from mild to hostile, {settings} settings of `a` and `b`, grids of {points} points a side:
{cells} solves with the arc-length monitor and otherwise default settings, each on one thread.
`benchmarks/robustness.py` runs them and writes this page; the numbers are in `benchmarks/robustness.json`.
The method was developed on these functions, so the counts are not those of functions that it has not seen:
those are [elsewhere](../how-to/which-monitor.md#functions-that-nobody-tuned-to).
{missing}\
All of them are of one run of this release.

## Summary
"""

HONESTY = """
"`a` reached" allows a [cross-line term](../how-to/relaxed.md#what-a-weight-costs): the mesh adapts to the whole
monitor, but its equations also make its lines straighter. The weight says how much: 0.01 costs a few percent of the
gain of the mesh, 0.1 up to 40 %, and 3 often most of it. "Without any relaxation" is the strict count: the requested
equations are solved to the accuracy of the grid. The relaxations, in numbers of solves:
"""

READING = """
## All cells

An entry reads `J · Q · ×gain · steps · time`: the smallest corner Jacobian (1 on the uniform mesh, not positive on a
folded one); the largest Q_eq (1 where cells have equal shares of the metric); how many times smaller the L2 error of
interpolation is than on the uniform mesh (below 1 it is larger: arc length follows gradients, not errors); sweeps and
Newton steps on the finest grid, including those of failed attempts; CPU seconds of the whole solve. Relaxations are in
bold: **c** the weight of the cross-line term, **a** the reached strength where it is less than requested, **n** the
points a side of the solved grid where it is coarser. All entries without bold satisfy the requested equations.
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
    """The text of the page."""
    points = sorted({result["n"] for result in results})
    settings = sorted({(result["a"], result["b"]) for result in results}, key=lambda one: (-one[1], one[0]))
    functions = {result["name"] for result in results}
    listed = ", ".join(map(str, points[:-1])) + f" and {points[-1]}" if points[1:] else str(points[0])
    absent = len(functions) * len(settings) * len(points) - len(results)
    missing = f"{absent} more were not run, the empty places in the tables.\n" if absent else ""
    head = INTRODUCTION.format(
        missing=missing, functions=len(functions), settings=len(settings), points=listed, cells=len(results)
    )
    lines = [head, *_summary(results), HONESTY, *_relaxations(results, points), "", *_worst(results), READING]
    for a, b in settings:
        here = {(r["name"], r["n"]): r for r in results if (r["a"], r["b"]) == (a, b)}
        lines += [f"### a = {a:g}, b = {b:g}", "", *_table(here, points), ""]
    ways = robustness_ways.read()
    lines += [*robustness_ways.section(ways), ""] if ways else []
    lines += ["## The functions", "", "| name | u | hard for |", "|---|---|---|"]
    lines += [f"| {name} | `{one.u}` | {one.hard} |" for name, one in FUNCTIONS.items() if name in functions]
    return "\n".join(lines) + "\n"


def _summary(results: Sequence[Result]) -> Iterator[str]:
    mild = [result for result in results if result["b"] >= MILD_B]
    yield "| | goal | measured |"
    yield "|---|---|---|"
    yield f"| folded meshes | 0 | {sum(bool(r.get('folded')) for r in results)} |"
    yield f"| exceptions | 0 | {sum('exception' in r for r in results)} |"
    yield f"| solves without a valid mesh | | {sum(r.get('status') not in SUCCEEDED for r in results)} |"
    rows = (
        ("requested `a` reached", reached, "95 %", "85 %"),
        (f"the same, with a cross-line weight of at most {LIGHT:g}", lightly, "", ""),
        ("requested equations satisfied, without any relaxation", exact, "", ""),
        ("u interpolated better than on the uniform mesh", gains, "", ""),
    )
    for what, holds, mild_goal, goal in rows:
        yield f"| {what}; b >= {MILD_B:g} | {mild_goal} | {_share(holds, mild)} |"
        yield f"| {what}; all | {goal} | {_share(holds, results)} |"


def _share(holds: Callable[[Result], bool], results: Sequence[Result]) -> str:
    count = sum(map(holds, results))
    return f"{100 * count / max(len(results), 1):.1f} % ({count} of {len(results)})"


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


def _relaxations(results: Sequence[Result], points: Sequence[int]) -> Iterator[str]:
    needs = {_need(result) for result in results}
    first, last = ["nothing"], ["less a", "coarser grid", "no mesh"]
    weights = sorted((need for need in needs - {*first, *last}), key=lambda need: float(need.split()[1]))
    yield "| relaxed | " + " | ".join(map(str, points)) + " | all |"
    yield "|---" * (len(points) + 2) + "|"
    for need in [*first, *weights, *last]:
        counts = [sum(_need(r) == need for r in results if r["n"] == n) for n in points]
        yield f"| {need.replace('less a', 'less `a`')} | " + " | ".join(map(str, [*counts, sum(counts)])) + " |"


def _worst(results: Sequence[Result]) -> Iterator[str]:
    """The cells that are farthest from the request."""

    def distance(result: Result) -> tuple[bool, float, bool, float, float]:
        relaxed = result.get("relaxed", {})
        lost = 1.0 - relaxed.get("a", result["a"]) / result["a"]
        failed = result.get("status") not in SUCCEEDED
        return failed, lost, "points" in relaxed, relaxed.get("cross_line", 0.0), result.get("q_eq") or 0.0

    yield "The cells farthest from the request, worst first:"
    yield ""
    yield "| function | a, b | n | entry |"
    yield "|---|---|---|---|"
    for result in sorted(results, key=distance, reverse=True)[:WORST]:
        yield f"| {result['name']} | {result['a']:g}, {result['b']:g} | {result['n']} | {entry(result)} |"


def _table(results: dict[tuple[str, int], Result], points: Sequence[int]) -> Iterator[str]:
    yield "| u | " + " | ".join(map(str, points)) + " |"
    yield "|---" * (len(points) + 1) + "|"
    for name in FUNCTIONS:
        entries = [entry(results[name, n]) if (name, n) in results else "" for n in points]
        if any(entries):
            yield f"| {name} | " + " | ".join(entries) + " |"


def entry(result: Result) -> str:
    """One cell of the tables."""
    if "exception" in result:
        return f"**{result['exception'].split(':')[0]}** · {result['cpu']:.1f} s"
    bold = [f"**{mark} {result['relaxed'][what]:g}**" for what, mark in MARKS.items() if what in result["relaxed"]]
    bold += [f"**{result['status']}**"] if result["status"] not in SUCCEEDED else []
    if result["folded"]:
        return " ".join(["**folded**", *bold])
    gain = "-" if result["gain"] is None else f"×{result['gain']:.2g}"
    numbers = f"{result['jacobian']:.2g} · {result['q_eq']:.3g} · {gain} · {result['steps']} · {result['cpu']:.1f} s"
    return " ".join([numbers, *bold])


MARKS = {"a": "a", "cross_line": "c", "points": "n"}


def read() -> list[Result]:
    """The stored results."""
    results: list[Result] = json.loads(DATA.read_text())
    return results


def write(results: Sequence[Result]) -> None:
    """Store the results, sorted, one a line, and write the page."""
    names = list(FUNCTIONS)
    key = [(-r["b"], r["a"], names.index(r["name"]), r["n"]) for r in results]
    ordered = [results[k] for k in sorted(range(len(results)), key=key.__getitem__)]
    DATA.write_text("[\n" + ",\n".join(map(json.dumps, ordered)) + "\n]\n")
    PAGE.write_text(render(ordered))


if __name__ == "__main__":
    write(read())
