"""The panel of the domain: its kinds, curves that are drawn and moved, and faults where they are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import equimesh as em
from browser.workbench.panels import answered, fault_of, panel, set_number, spec_of
from equimesh_schema.domains import DOMAINS

pytestmark = pytest.mark.needs("chromium")
POINTS = [[0.0, 0.0], [1.0, 0.3], [1.5, 0.2], [3.0, 0.5], [3.5, 1.0]]
FORMULAS = [
    "3*t",
    "-t**2 + 2**-t",
    "0.2*sin(pi*t)**8",
    "where(t < 0.5 and not t > 0.25, 1 - t, exp(-t))",
    "hypot(t, 1)/atan2(1, t + 1) - min(t, 0.5, 2)*max(.5, t)",
    "erf(3*t) + log10(1 + t) + abs(t - 0.3) + sign(t - 0.41) + e*1e-1",
]


def test_rectangles_and_rings_by_their_numbers(page: Page) -> None:
    box = panel(page, "domain")
    kinds = box.get_by_label("Kind", exact=True)
    assert {*kinds.locator("option").evaluate_all("all => all.map((one) => one.value)")} == {*DOMAINS.documents}
    set_number(box, "x from", -1)
    answer = answered(page, lambda: box.locator(".pair").first.get_by_label("to", exact=True).fill("2.5"))
    assert answer.status == 200, answer.text()
    assert spec_of(page)["domain"] == {"x": [-1, 2.5]}
    kinds.select_option("annulus_sector")
    expect(box.get_by_text(DOMAINS.documents["annulus_sector"].USE)).to_be_visible()
    set_number(box, "outer radius", 3)
    set_number(box, "last angle", 180)
    answer = answered(page, lambda: set_number(box, "centre x", 1))
    assert answer.status == 200, answer.text()
    told = {"kind": "annulus_sector", "radii": [1, 3], "angles": [0, 180], "center": [1, 0]}
    assert spec_of(page)["domain"] == told
    assert box.locator(".outline polyline").count() == 4
    kinds.select_option("rectangle")
    assert "domain" not in spec_of(page)


@pytest.mark.everything
def test_another_kind_becomes_four_curves_at_the_same_place(page: Page) -> None:
    box = panel(page, "domain")
    kinds = box.get_by_label("Kind", exact=True)
    kinds.select_option("annulus_sector")
    before = box.locator(".outline polyline").evaluate_all("all => all.map((one) => one.getAttribute('points'))")
    answer = answered(page, lambda: kinds.select_option("quadrilateral"))
    assert answer.status == 200, answer.text()
    after = box.locator(".outline polyline").evaluate_all("all => all.map((one) => one.getAttribute('points'))")
    assert before == after


def test_points_are_moved_by_keys_and_by_the_pointer_and_a_corner_moves_both_sides(page: Page) -> None:
    box = panel(page, "domain")
    answered(page, lambda: box.get_by_label("Kind", exact=True).select_option("quadrilateral"))
    corner = box.get_by_role("button", name="bottom, point 2")
    corner.focus()
    answer = answered(page, lambda: page.keyboard.press("ArrowRight"))
    assert answer.status == 200, answer.text()
    domain = spec_of(page)["domain"]
    assert domain["bottom"]["points"] == [[0, 0], [1.02, 0]]
    assert domain["right"]["points"] == [[1.02, 0], [1, 1]]
    top = box.get_by_label('Points of top, one "x, y" a line')
    answered(page, lambda: top.fill("0, 1\n0.5 1.2\n1, 1"))  # what an answer shows can move what is below it
    handle = box.get_by_role("button", name="top, point 2")
    handle.hover()
    place = handle.bounding_box()
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    page.mouse.down()
    page.mouse.move(x, y - 12, steps=3)
    page.mouse.up()
    moved = spec_of(page)["domain"]["top"]["points"][1]
    assert moved[1] > 1.23
    assert abs(moved[0] - 0.5) < 0.01
    expect(top).to_have_value(f"0, 1\n{moved[0]:g}, {moved[1]:g}\n1, 1")


def test_a_side_by_formulas_with_a_parameter_and_a_fault_at_its_field(page: Page) -> None:
    box = panel(page, "domain")
    box.get_by_label("Kind", exact=True).select_option("quadrilateral")
    box.get_by_label("bottom is given by").select_option("formulas")
    assert spec_of(page)["domain"]["bottom"] == {"x": "0 + 1*t", "y": "0"}
    y = box.get_by_label("y(t) of bottom")
    y.fill("h*sin(pi*t)")
    answer = answered(page, lambda: box.get_by_label("h", exact=True).fill("0.2"))
    assert answer.status == 200, answer.text()
    assert spec_of(page)["domain"]["bottom"]["parameters"] == {"h": 0.2}
    assert "h*sin(pi*t)" in (y.input_value())
    y.fill("sin(pi*t")
    expect(fault_of(y)).not_to_be_empty()
    y.fill("t/2")  # the corner is elsewhere
    expect(box.locator(".fault:visible").filter(has_text="corner").first).to_be_visible()
    box.get_by_label("bottom is given by").select_option("points")
    assert len(spec_of(page)["domain"]["bottom"]["points"]) == 9
    box.get_by_label('Points of left, one "x, y" a line').fill("0, 0\nhere")
    expect(box.get_by_text("Each line is two numbers")).to_be_visible()


def test_the_page_draws_the_curves_of_the_solver(visit: Callable[..., Page]) -> None:
    page = visit("/#u=x&n=9&monitor=arc_length")
    drawn = page.evaluate(
        """async ([points, formulas]) => {
          const { pointsOf } = await import(new URL("workbench/sides.js", document.baseURI));
          const { compile } = await import(new URL("workbench/formula.js", document.baseURI));
          const times = Array.from({ length: 11 }, (_, k) => k / 10);
          return {
            splines: [3, 4, 5].map((count) => pointsOf({ points: points.slice(0, count) })),
            values: formulas.map((text) => times.map((t) => compile(text)({ t }))),
            refused: ["", "1 +", "t t", "open(t)", "t^2", "(t"].map(compile),
          };
        }""",
        [POINTS, FORMULAS],
    )
    for count, spline in zip((3, 4, 5), drawn["splines"], strict=True):
        x, y, _, _ = em.Curve.through(POINTS[:count]).evaluate(np.linspace(0, 1, len(spline)))
        assert np.abs(np.array(spline) - np.stack([x, y], axis=-1)).max() < 1e-12
    for formula, values in zip(FORMULAS, drawn["values"], strict=True):
        x, *_ = em.Curve.of_expressions(formula, "0").evaluate(np.linspace(0, 1, 11))
        assert np.abs(np.array(values) - x).max() < 1e-6, formula
    assert drawn["refused"] == [None] * 6


def test_blocks_are_pasted_drawn_and_told(page: Page) -> None:
    box = panel(page, "domain")
    box.get_by_label("Kind", exact=True).select_option("blocks")
    spec = spec_of(page)
    assert "grid" not in spec
    assert spec["monitor"] == {"u": {"expression": "tanh(20*(x-y))"}}
    panel(page, "monitor").get_by_label("Kind", exact=True).select_option("least_error")  # less work than auto
    assert box.locator(".outline polyline").count() == 12
    description = box.get_by_label("Description, as JSON")
    text = description.input_value()
    description.fill(text[:-2])
    expect(box.get_by_text("This is no JSON")).to_be_visible()
    description.fill(text.replace('"cells":[16,16]', '"cells":[12,8]', 1))  # its quick look is refused, and enough
    expect(box.get_by_text("give both the same number")).to_be_visible()
    answer = answered(page, lambda: description.fill(text.replace('"cells":[16,16]', '"cells":[6,4],"name":"part"', 4)))
    assert answer.status == 200, answer.text()
    expect(page.locator("#panel-numbers").get_by_role("row", name="blocks 4")).to_be_visible()
    expect(page.locator(".blend label")).to_have_text("initial")
    page.locator("#stage").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#tip")).to_contain_text("part, cell")
    chosen = panel(page, "grid").get_by_label("Points for which they are chosen")
    answer = answered(page, lambda: chosen.fill("150"))
    assert (answer.status, spec_of(page)["grid"]) == (200, {"points": 150}), answer.text()
    chosen.fill("30")
    expect(fault_of(chosen)).to_contain_text("the coarsest mesh of these blocks")
    chosen.fill("")
    assert "grid" not in spec_of(page)
    answer = answered(page, lambda: box.get_by_label("Kind", exact=True).select_option("fixed_rectangle"))
    assert answer.status == 200, answer.text()
    assert '"points": [' in box.get_by_label("Rectangle, as JSON").input_value()
    assert box.locator(".outline .side").count() == 5  # the sides, and the curve
    assert spec_of(page)["domain"]["layers"] == {"bottom": {"first": 0.005, "growth": 1.3, "count": 5}}
