"""The panel of the grid: points or an error, and how the mesh is solved and written."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from browser.workbench.panels import answered, fault_of, panel, set_number, spec_of

pytestmark = pytest.mark.needs("chromium")


def test_points_by_a_button_or_typed(page: Page) -> None:
    box = panel(page, "grid")
    button = box.get_by_role("button", name="33 × 33")
    answer = answered(page, button.click)
    assert answer.status == 200
    assert spec_of(page)["grid"] == {"n_xi": 33, "n_eta": 33}
    expect(button).to_have_attribute("aria-pressed", "true")
    set_number(box, "Points along xi", 9)
    set_number(box, "Points along eta", 64)
    assert spec_of(page)["grid"] == {"n_xi": 9}  # 64 is what the service takes by itself
    field = box.get_by_label("Points along xi")
    field.fill("2")
    expect(fault_of(field)).to_contain_text("4")


def test_an_error_takes_the_place_of_the_grid_and_gives_it_back(page: Page) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    box = panel(page, "grid")
    by = box.get_by_label("Grid given by")
    answer = answered(page, lambda: by.select_option("error"))
    assert answer.status == 200, answer.text()
    spec = spec_of(page)
    assert "grid" not in spec
    assert 0 < spec["target"]["error"] < 1
    box.get_by_label("Error", exact=True).select_option("h1")
    set_number(box, "At most so many points", 5000)
    set_number(box, "Interpolation error", 3)
    assert spec_of(page)["target"] == {"error": 3, "norm": "h1", "max_points": 5000}
    by.select_option("points")
    spec = spec_of(page)
    assert "target" not in spec
    assert spec["grid"] == {"n_xi": 17, "n_eta": 17}


def test_everything_else_of_the_mesh(page: Page) -> None:
    box = panel(page, "grid")
    box.get_by_label("Points on the sides").select_option("orthogonal")
    box.get_by_label("Solved to").select_option("tight")
    box.get_by_label("Initial mesh").select_option("uniform")
    box.get_by_label("Accept relaxed meshes").uncheck()
    answer = answered(page, lambda: box.get_by_label("Cells of the file").select_option("triangle"))
    assert answer.status == 200, answer.text()
    told = {
        "boundary": "orthogonal",
        "mode": "tight",
        "initial": "uniform",
        "allow_relaxed": False,
        "cells": "triangle",
    }
    spec = spec_of(page)
    assert spec | told == spec
    expect(box.get_by_label("Parts of the cluster", exact=True)).to_be_hidden()  # there is no cluster
