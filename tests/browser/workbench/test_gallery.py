"""The gallery of the workbench: problems that the service takes, and whose meshes are worth something."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from equimesh_service.spec.mesh import read_spec

SCRIPT = runpy.run_path(str(Path(__file__).parents[3] / "deploy" / "gallery_pictures.py"))
GALLERY = SCRIPT["problems"]()
NAMES = [problem["name"] for problem in GALLERY]
ORDINARY = 3
"""Problems that an ordinary run solves."""
WAITING = [pytest.param(problem, marks=pytest.mark.everything) for problem in GALLERY[ORDINARY:]]
PICTURES = json.loads(files("equimesh_service").joinpath("workbench", "gallery_pictures.json").read_text())


def test_there_are_fourteen_problems_of_different_names_with_pictures() -> None:
    assert len(GALLERY) == len({*NAMES}) == 14
    assert [*PICTURES] == NAMES
    for problem in GALLERY:
        assert {*problem} - {"time"} == {"name", "title", "sentence", "spec", "sliders"}
        assert problem["sentence"].endswith(".")
        assert len(problem["title"]) < 24


@pytest.mark.parametrize("problem", GALLERY, ids=NAMES)
def test_a_problem_is_a_spec_whose_parameters_are_within_their_sliders(problem: dict[str, Any]) -> None:
    u = read_spec(problem["spec"]).canonical["monitor"]["u"]
    assert {*problem["sliders"]} == {*u["parameters"]}
    for name, ends in problem["sliders"].items():
        assert ends["min"] < u["parameters"][name] < ends["max"]
    if "time" in problem:
        assert problem["time"]["min"] <= u["t"] <= problem["time"]["max"]
    else:
        assert u["t"] == 0


@pytest.mark.parametrize("problem", [*GALLERY[:ORDINARY], *WAITING], ids=NAMES)
def test_the_mesh_of_a_problem_is_that_of_its_picture_with_a_much_smaller_error(problem: dict[str, Any]) -> None:
    solution = SCRIPT["solve"](problem)
    gains = solution.certificate.interpolation
    assert gains.gain_l2 > 4.5
    assert gains.gain_h1 > 1.9
    drawn, stored = SCRIPT["picture"](solution), PICTURES[problem["name"]]
    assert drawn.keys() == stored.keys()
    for one, kept in zip(drawn.get("blocks", [drawn]), stored.get("blocks", [stored]), strict=True):
        assert one["shape"] == kept["shape"]
        # Descents amplify rounding: some nodes lie a little elsewhere on another processor.
        assert np.abs(np.subtract(one["nodes"], kept["nodes"])).mean() <= 1
        assert np.abs(np.subtract([*map(int, one["u"])], [*map(int, kept["u"])])).mean() <= 0.2


@pytest.mark.needs("chromium")
@pytest.mark.everything
def test_on_a_phone_the_page_goes_to_the_mesh_of_a_chosen_problem(visit: Callable[..., Page]) -> None:
    page = visit("/#u=x*y&n=9&monitor=arc_length", viewport={"width": 390, "height": 844})
    page.get_by_role("button", name="Moving front").click()
    expect(page.locator("#headline")).to_be_in_viewport(timeout=10_000)
    expect(page.locator("#stage")).to_be_in_viewport(ratio=0.8)
