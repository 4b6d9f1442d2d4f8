"""All panels of a spec together: read by a screen reader, used by keys, on a phone, light and dark."""

from __future__ import annotations

import json
from collections.abc import Callable
from urllib.parse import quote

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from browser.workbench.panels import panel, spec_of

pytestmark = pytest.mark.needs("chromium")
PANELS = ("gallery", "monitor", "domain", "grid", "schwarz", "copy", "downloads", "key")
PHONE = {"width": 390, "height": 844}
FULL = {
    "monitor": {
        "kind": "intersection",
        "monitors": [
            {"kind": "curvature", "u": {"expression": "tanh(k*(x-y))", "parameters": {"k": 9}}},
            {"kind": "tensor", "m11": {"expression": "2"}, "m12": {"expression": "0"}, "m22": {"expression": "1"}},
        ],
    },
    "domain": {
        "kind": "quadrilateral",
        "bottom": {"x": "3*t", "y": "h*sin(pi*t)**8", "parameters": {"h": 0.15}},
        "right": {"points": [[3, 0], [3, 1]]},
        "top": {"points": [[0, 1], [1.5, 1.1], [3, 1]]},
        "left": {"points": [[0, 0], [0, 1]]},
    },
    "grid": {"n_xi": 17, "n_eta": 9},
    "schwarz": {"transmission": {"kind": "linear_robin", "p": 2}},
}


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.everything)])
def test_axe_finds_nothing_and_nothing_is_wider_than_a_phone(scheme: str, visit: Callable[..., Page]) -> None:
    page = visit(f"/#spec={quote(json.dumps(FULL))}", color_scheme=scheme, viewport=PHONE)
    page.complaints.expected = ["status of 409"]  # type: ignore[attr-defined]  # a preview that took too long
    expect(page.locator(".gallery button")).to_have_count(14)
    for name in PANELS:
        panel(page, name)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()


def test_the_panels_are_used_by_keys_alone(page: Page) -> None:
    summary = page.locator("#panel-grid summary").first
    summary.focus()
    page.keyboard.press("Enter")
    for _ in range(2):  # the kind of the grid, and the first button
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert spec_of(page)["grid"] == {"n_xi": 33, "n_eta": 33}


def test_a_problem_of_the_gallery_is_chosen_and_marked(page: Page) -> None:
    box = panel(page, "gallery")
    buttons = box.locator(".gallery button")
    expect(buttons).to_have_count(14)
    page.wait_for_function(
        """() => [...document.querySelectorAll('.gallery canvas')].every((one) =>
          one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some((value) => value > 0))"""
    )
    for name, sliders in (("bump", 2), ("moving-front", 2)):
        button = box.locator(f"[data-name={name}]")
        button.click()
        expect(button).to_have_attribute("aria-pressed", "true")
        expect(box.get_by_text(button.get_attribute("title") or "")).to_be_visible()
        assert page.locator("#panel-function input[type=range]").count() == sliders - (name == "bump")
    assert spec_of(page)["monitor"]["u"]["t"] == 0.3
    panel(page, "monitor").get_by_label("Error to make small").select_option("h1")
    expect(box.locator("[data-name=moving-front]")).to_have_attribute("aria-pressed", "true")
