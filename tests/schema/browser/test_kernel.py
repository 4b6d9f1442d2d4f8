"""The meshes of pages are those of the solver, as the page says: the twelve problems of the gallery on grids."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh import specs
from equimesh.meshes.mesh import smallest_jacobian
from equimesh_schema.browser.scripts import KERNEL, script

Run = Callable[..., Any]
ROOT = Path(__file__).parents[3]
GALLERY = json.loads((ROOT / "service/equimesh_service/workbench/gallery.json").read_text())["problems"]
PROBLEMS = {problem["name"]: problem["spec"] for problem in GALLERY if "grid" in problem["spec"]}
# Points of the shorter direction. Without --everything every third problem is solved, with few.
SOLVED = [
    *(pytest.param(name, 17, marks=[pytest.mark.everything] if k % 3 else []) for k, name in enumerate(PROBLEMS)),
    *(pytest.param(name, 33, marks=pytest.mark.everything) for name in PROBLEMS),
]
NEAR = 1e-3
"""Of the nodes of an arc length, as a share of the domain: what the page says."""
LIKE = 0.1
"""Of the gains of least error: what the page says."""
SOLVE = """
const { u: { expression, parameters, t }, domain, shape, kind } = given;
const u = kernel.compile(expression, { ...parameters, t: t ?? 0 });
const placed = kernel.domainOf(domain);
let last;
for (last of kernel[kind](u, shape, placed));
return { ...kernel.comparison(u, placed, shape)(last), isConverged: last.isConverged };
"""


def document(name: str, short: int) -> dict[str, Any]:
    """The problem on few points, as a request."""
    spec = PROBLEMS[name]
    counts = {axis: points - 1 for axis, points in spec["grid"].items()}
    grid = {axis: round(cells * (short - 1) / min(counts.values())) + 1 for axis, cells in counts.items()}
    return {**spec, "grid": grid}


def preview(kernel: Run, spec: dict[str, Any], kind: str) -> dict[str, Any]:
    """What a page shows of a problem."""
    shape = [spec["grid"]["n_xi"], spec["grid"]["n_eta"]]
    given = {"u": spec["monitor"]["u"], "domain": spec.get("domain"), "shape": shape, "kind": kind}
    found = kernel(SOLVE, given)
    arrays = {key: np.reshape(found[key], shape) for key in ("x", "y", "uniformX", "uniformY")}
    return {**found, **arrays}


@pytest.mark.parametrize(("name", "short"), SOLVED)
def test_the_arc_length_of_a_page_is_the_mesh_of_the_solver(kernel: Run, name: str, short: int) -> None:
    spec = document(name, short)
    shown = preview(kernel, spec, "arcLength")
    solution = specs.build({**spec, "monitor": {"kind": "arc_length", "u": spec["monitor"]["u"]}}).solve(check=False)
    assert smallest_jacobian(shown["x"], shown["y"]) > 0
    # Where the solver has to weaken its equations, the page does not say that its mesh fulfils them.
    assert shown["isConverged"] == (solution.status.name == "CONVERGED")
    if shown["isConverged"]:
        assert abs(shown["x"] - solution.mesh.x).max() < NEAR * np.ptp(solution.mesh.x)
        assert abs(shown["y"] - solution.mesh.y).max() < NEAR * np.ptp(solution.mesh.y)


@pytest.mark.parametrize(("name", "short"), SOLVED)
def test_the_least_error_of_a_page_has_the_gain_of_the_solver(kernel: Run, name: str, short: int) -> None:
    spec = document(name, short)
    shown = preview(kernel, spec, "leastError")
    solution = specs.build({**spec, "monitor": {"kind": "least_error", "u": spec["monitor"]["u"]}}).solve(check=False)
    gain = solution.certificate.interpolation_gain
    assert shown["gain"] == pytest.approx(gain.l2, rel=LIKE)
    assert shown["gain"] == pytest.approx(shown["l2Uniform"] / shown["l2"])
    assert smallest_jacobian(shown["x"], shown["y"]) > 0


def test_the_kernel_loads_at_once() -> None:
    assert len(script(KERNEL).encode()) < 60_000


def test_no_mesh_of_a_page_is_worse_than_the_uniform_one_or_folded(kernel: Run) -> None:
    texts = ["0*x", "x + y", "where(x < 0.5, 0, 1)", "tanh(300*(x + y - 0.15))", "(x**2 + y**2)**0.35", "sin(40*x*y)"]
    for text in texts:
        given = {"u": {"expression": text}, "domain": None, "shape": [17, 13], "kind": "leastError"}
        shown = kernel(SOLVE, given)
        assert shown["gain"] >= 1 - 1e-12, text
        assert smallest_jacobian(np.reshape(shown["x"], (17, 13)), np.reshape(shown["y"], (17, 13))) > 0, text


def test_a_mesh_that_is_given_is_where_the_descent_begins(kernel: Run) -> None:
    program = """
    const u = (c) => kernel.compile("tanh(20*(x - y - c))", { c });
    const [shape, square] = [[17, 17], kernel.domainOf()];
    const steps = (formula, settings) => [...kernel.leastError(formula, shape, square, settings)];
    const first = steps(u(0)).at(-1);
    const next = steps(u(0.03), { start: first.mesh, steps: 8 });
    const gain = (formula, one) => kernel.comparison(formula, square, shape)(one).gain;
    return [next.length, gain(u(0.03), next.at(-1)), gain(u(0.03), first)];
    """
    steps, after, before = kernel(program)
    assert steps <= 9
    assert after > before


@pytest.mark.parametrize(
    "description",
    [
        {"kind": "blocks"},
        {"periodic": "x"},
        {"kind": "quadrilateral", "bottom": {"points": [[0, 0], [1, 0], [2, 1], [3, 1]]}},
    ],
)
def test_a_domain_that_pages_do_not_have_is_refused_with_a_sentence(kernel: Run, description: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"the kernel of the page has no .*: the service makes this mesh"):
        kernel("return kernel.domainOf(given)", description)
