"""The panel of the grid: points or an error, and how the mesh is solved and written."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from browser.workbench.panels import answered, fault_of, panel, set_number, spec_of, unfold
from equimesh_schema import schwarz
from equimesh_schema.monitors import MONITORS

pytestmark = pytest.mark.needs("chromium")


def test_points_by_a_button_or_typed_and_everything_else_of_the_mesh(page: Page) -> None:
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
    field.fill("9")
    choose_everything_else(page, box)


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


def choose_everything_else(page: Page, box: Locator) -> None:
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


def test_the_iteration_is_switched_on_and_off_with_its_settings_kept(page: Page) -> None:
    box = panel(page, "schwarz")
    switch = box.get_by_label("Divide into subdomains")
    answer = answered(page, switch.check)
    assert answer.status == 200, answer.text()
    assert spec_of(page)["schwarz"] == {}
    set_number(box, "subdomains along xi", 3)
    set_number(box, "along eta", 2)
    switch.uncheck()
    assert "schwarz" not in spec_of(page)
    expect(box.get_by_label("Overlap in points")).to_be_hidden()
    switch.check()
    assert spec_of(page)["schwarz"] == {"subdomains": [3, 2]}


def test_every_setting_is_reachable_and_taken(page: Page) -> None:
    box = panel(page, "schwarz")
    box.get_by_label("Divide into subdomains").check()
    condition = box.get_by_label("Transmission condition")
    for kind, use in [(kind, made.USE) for kind, made in schwarz.TRANSMISSIONS.documents.items()]:
        condition.select_option(kind)
        expect(box.get_by_text(use)).to_be_visible()
    assert spec_of(page)["schwarz"] == {"transmission": {"kind": "nonlinear_robin"}}
    tolerance = box.get_by_label("Tolerance", exact=True)
    for word, told in (("discretization", {"tolerance": "discretization"}), ("", {"tolerance": None}), ("number", {})):
        tolerance.select_option(word)
        assert spec_of(page)["schwarz"] == {"transmission": {"kind": "nonlinear_robin"}, **told}
    condition.select_option("optimized")
    box.get_by_label("Data of an interface").select_option("local")
    assert spec_of(page)["schwarz"]["transmission"] == {"kind": "optimized", "data": "local"}
    condition.select_option("nonlinear_robin")
    box.get_by_label("Parameter p", exact=True).select_option("number")
    set_number(box, "Parameter p, a number", 3)
    set_number(box, "Overlap in points", 3)
    box.get_by_label("Ordering").select_option("alternating")
    box.get_by_label("Line corrections", exact=True).select_option("number")
    set_number(box, "Line corrections, a number", 2)
    box.get_by_label("Acceleration").select_option("none")
    box.get_by_label("Local solver").select_option("newton")
    box.get_by_label("Fall back").uncheck()
    set_number(box, "Tolerance, a number", 1e-6)
    set_number(box, "Most iterations", 40)
    answer = answered(page, box.get_by_label("Compare with the single domain").check)
    assert answer.status == 200, answer.text()
    assert spec_of(page)["schwarz"] == {
        "transmission": {"kind": "nonlinear_robin", "p": 3},
        "overlap": 3,
        "ordering": "alternating",
        "line_correction": 2,
        "acceleration": "none",
        "local_solver": "newton",
        "fallback": False,
        "tolerance": 1e-6,
        "max_iterations": 40,
        "compare_single_domain": True,
    }


@pytest.mark.everything
def test_subdomains_of_least_error_have_steps_and_exchanges(page: Page) -> None:
    panel(page, "monitor").get_by_label("Kind", exact=True).select_option("least_error")
    box = panel(page, "schwarz")
    box.get_by_label("Divide into subdomains").check()
    set_number(box, "For least error: steps in one exchange", 4)
    box.get_by_label("For least error: most exchanges", exact=True).select_option("number")
    answer = answered(page, lambda: set_number(box, "For least error: most exchanges, a number", 3))
    assert answer.status == 200, answer.text()
    assert spec_of(page)["schwarz"] == {"local_steps": 4, "max_exchanges": 3}
    box.get_by_label("For least error: most exchanges", exact=True).select_option("")
    assert spec_of(page)["schwarz"] == {"local_steps": 4}


# By kind: fields with what is put into them, and the settings that this gives.
CHOSEN: dict[str, dict[str, tuple[object, dict[str, object]]]] = {
    "auto": {
        "Error to make small": ("h1", {"norm": "h1"}),
        "Chosen for": ("finite_volume", {"for": "finite_volume"}),
        "Largest angle": (60, {"orthogonality": 60}),
    },
    "least_error": {
        "Distortion": (0.2, {"distortion": 0.2}),
        "Smoothness": (0.5, {"smoothness": 0.5}),
        "Rectilinear": (True, {"rectilinear": True}),
    },
    "arc_length": {
        "Strength a": (0.5, {"a": 0.5}),
        "Damping b": (0.1, {"b": 0.1}),
        "Scaled": (False, {"scaled": False}),
        "Smoothing": (0.02, {"smoothing": 0.02}),
    },
    "curvature": {"Isotropic": (True, {"isotropic": True})},
    "weight": {
        "Density rho(x, y)": ("1 + c*x", {"rho": {"expression": "1 + c*x", "parameters": {"c": 1}}}),
        "Map": ("gradient", {"map": "gradient"}),
    },
    "tensor": {"m11(x, y)": ("4", {"m11": {"expression": "4"}})},
}


def put(box: Any, label: str, value: object) -> None:
    control = box.get_by_label(label, exact=True)
    if isinstance(value, bool):
        control.set_checked(value)
    elif control.evaluate("node => node.tagName") == "SELECT":
        control.select_option(str(value))
    else:
        control.fill(str(value))


@pytest.mark.everything
def test_every_kind_and_setting_is_reachable_and_taken(page: Page) -> None:
    page.complaints.expected = ["status of 409"]  # type: ignore[attr-defined]
    box = panel(page, "monitor")
    kinds = box.get_by_label("Kind", exact=True)
    assert {*kinds.locator("option").evaluate_all("all => all.map((one) => one.value)")} == {*MONITORS.documents}
    for kind, settings in CHOSEN.items():
        kinds.select_option(kind)
        unfold(box)
        expect(box.locator(".hint").first).to_have_text(MONITORS.documents[kind].USE)
        for label, (value, given) in settings.items():
            put(box, label, value)
            monitor = spec_of(page)["monitor"]
            assert monitor.get("kind", "auto") == kind
            assert monitor | given == monitor, (kind, label)
        answer = answered(page, lambda: set_number(box, "Largest angle", 80))
        assert answer.status in (200, 409), (kind, answer.text())  # 409: taken, but not finished in time
        set_number(box, "Largest angle", "")
        assert "orthogonality" not in spec_of(page)["monitor"]


def test_a_fault_of_the_service_is_shown_at_its_field(page: Page) -> None:
    box = panel(page, "monitor")
    field = box.get_by_label("Strength a", exact=True)
    field.fill("2")
    expect(field).to_have_attribute("aria-invalid", "true")
    fault = fault_of(field)
    expect(fault).to_contain_text("1")
    assert fault.get_attribute("id") in (field.get_attribute("aria-describedby") or "")
    answered(page, lambda: field.fill("1"))
    expect(fault).to_be_empty()
    expect(field).not_to_have_attribute("aria-invalid", "true")
    field.fill("")
    expect(fault).to_have_text("Type a number.")
    for value in (0.3, 0.7):
        field.fill(str(value))
        assert spec_of(page)["monitor"].get("a", 0.7) == value
    assert "a" not in spec_of(page)["monitor"]  # a setting that is the default leaves the spec
    box.get_by_label("Kind", exact=True).select_option("weight")
    rho = box.get_by_label("Density rho(x, y)", exact=True)
    rho.fill("1 + sin(x*")
    expect(fault_of(rho)).to_contain_text("at character")


def test_the_slider_of_the_degree_changes_the_mesh_and_its_gains(visit: Callable[..., Page]) -> None:
    page = visit("/#u=sin(6*x)*cos(5*y)&n=17&monitor=least_error")
    box = panel(page, "monitor")
    slider = box.get_by_label("Degree of the elements", exact=True)
    expect(slider).to_have_attribute("aria-valuetext", "1: bilinear")
    gains = page.get_by_role("row", name="gain for elements of degree 1, 2, 3 (L2)").get_by_role("cell")
    expect(gains).to_have_text(re.compile(r"^[1-9][\d.]*, 0\.\d+, "))  # better for degree 1, worse for degree 2
    answer = answered(page, lambda: slider.press("ArrowRight"))
    assert answer.status == 200, answer.text()
    assert spec_of(page)["monitor"]["degree"] == 2
    expect(slider).to_have_attribute("aria-valuetext", "2: biquadratic")
    expect(gains).to_have_text(re.compile(r"^[\d.]+, [1-9]"))
    assert slider.get_attribute("max") == "4"
    box.get_by_label("Kind", exact=True).select_option("nodal_solution")
    assert box.get_by_label("Degree of the elements", exact=True).get_attribute("max") == "4"


def test_an_intersection_has_two_to_eight_members_of_any_kind(visit: Callable[..., Page]) -> None:
    page = visit("/#u=tanh(9*(x-y))&n=13&monitor=curvature")
    box = panel(page, "monitor")
    answer = answered(page, lambda: box.get_by_label("Kind", exact=True).select_option("intersection"))
    assert answer.status == 200, answer.text()
    u = {"expression": "tanh(9*(x-y))"}
    assert spec_of(page)["monitor"] == {"kind": "intersection", "monitors": [{"kind": "curvature", "u": u}, {"u": u}]}
    add = box.get_by_role("button", name="Add a monitor")
    for _ in range(6):
        add.click()
    expect(add).to_be_disabled()
    box.get_by_label("Kind of monitor 8").select_option("tensor")
    box.get_by_label("Kind of monitor 2").select_option("weight")
    last = box.get_by_role("group", name="Monitor 8")
    last.get_by_label("m22(x, y)", exact=True).fill("9")
    for number in (7, 6, 5, 4, 3):
        box.get_by_role("button", name=f"Remove monitor {number}").click()
    answer = answered(page, lambda: set_number(box.get_by_role("group", name="Monitor 1"), "Smoothing", 0.05))
    assert answer.status == 200, answer.text()
    members = spec_of(page)["monitor"]["monitors"]
    assert [member.get("kind", "arc_length") for member in members] == ["curvature", "weight", "tensor"]
    assert members[2]["m22"] == {"expression": "9"}
    assert members[0]["smoothing"] == 0.05
    box.get_by_role("button", name="Remove monitor 3").click()
    expect(box.get_by_role("button", name="Remove monitor 1")).to_be_disabled()
