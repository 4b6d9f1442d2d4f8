"""The page as a whole: what axe finds, sizes of screens, the keyboard, addresses, and words about the result."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from urllib.parse import quote, unquote

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from browser.workbench.panels import panel, spec_of

pytestmark = pytest.mark.needs("chromium")
SMALL = "/#u=tanh(20*(x-y))&n=17&monitor=arc_length"
DRAWN = "#stage[data-quick=false]"
UNFOLD = "() => document.querySelectorAll('aside details').forEach((each) => (each.open = true))"
SCREENS = ((390, 844), (1366, 768), (1920, 1080))


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.everything)])
def test_axe_finds_nothing(visit: Callable[..., Page], scheme: str) -> None:
    page = visit(SMALL, color_scheme=scheme, bypass_csp=True)
    page.wait_for_selector(DRAWN)
    page.evaluate(UNFOLD)
    page.fill("#panel-function textarea", "sin(x*")
    expect(page.locator("#panel-function .fault")).not_to_be_empty()
    results = Axe().run(page)
    assert [each["id"] for each in results.response["violations"]] == [], results.generate_report()


def test_nothing_is_wider_than_the_screen(visit: Callable[..., Page]) -> None:
    page = visit(SMALL, has_touch=True)
    page.wait_for_selector(DRAWN)
    page.evaluate(UNFOLD)
    for width, height in SCREENS:
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
        assert page.locator("#headline").bounding_box()["y"] < height / 2  # type: ignore[index]


def test_the_first_mesh_needs_no_action(visit: Callable[..., Page]) -> None:
    page = visit("/")
    page.wait_for_selector("#stage[data-quick]")
    expect(page.locator("#headline")).to_have_text(re.compile(r"\d times smaller than on a uniform mesh"))
    expect(page.locator("#headline")).to_have_class(re.compile("good"))
    page.wait_for_selector(DRAWN)
    expect(page.locator("#live")).to_have_text(page.locator("#headline").inner_text())  # it is announced


def test_a_mesh_that_is_worse_is_said_in_red(visit: Callable[..., Page]) -> None:
    page = visit(
        "/#" + 'spec={"monitor":{"kind":"weight","rho":"1+50*x","u":"exp(-8*x)"},"grid":{"n_xi":17,"n_eta":17}}'
    )
    expect(page.locator("#headline")).to_have_class(re.compile("bad"))
    expect(page.locator("#headline")).to_contain_text("larger than on a uniform mesh")


def test_the_keyboard_reaches_every_control_and_leaves_it(page: Page) -> None:
    page.wait_for_selector(DRAWN)
    page.locator("body").focus()
    reached = set()
    for _ in range(200):
        page.keyboard.press("Tab")
        here = page.evaluate(
            "() => { const e = document.activeElement; return e === document.body ? null"
            " : e.closest('section, header, figure, .skip')?.id || e.className || e.tagName; }"
        )
        if here is None:
            break
        reached.add(here)
    sections = set(page.eval_on_selector_all("section:not([hidden])", "all => all.map((each) => each.id)"))
    assert sections <= reached


def test_the_address_follows_every_change_and_brings_it_back(page: Page, visit: Callable[..., Page]) -> None:
    page.fill("#panel-function textarea", "x**2*y + tanh(9*(x+y-1))")
    page.get_by_label("Colour by").select_option("u")
    page.get_by_label("lines", exact=True).uncheck()
    page.wait_for_function("() => location.hash.includes('lines')")
    address = page.evaluate("() => location.hash")
    words = dict(word.split("=", 1) for word in unquote(address[1:]).split("&"))
    assert json.loads(words["spec"])["monitor"]["u"]["expression"] == "x**2*y + tanh(9*(x+y-1))"
    again = visit("/" + address)
    expect(again.locator("#panel-function textarea")).to_have_value("x**2*y + tanh(9*(x+y-1))")
    expect(again.get_by_label("Colour by")).to_have_value("u")
    expect(again.get_by_label("lines", exact=True)).not_to_be_checked()


def test_the_short_address_of_old_links_works(visit: Callable[..., Page]) -> None:
    page = visit("/#u=tanh(30*(x-y)+1)&n=9&monitor=curvature")
    page.wait_for_selector(DRAWN)
    expect(page.locator("#panel-function textarea")).to_have_value("tanh(30*(x-y)+1)")
    assert page.get_attribute("#stage", "data-points") == "9 9"


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
    button = box.locator("[data-name=moving-front]")
    button.click()
    expect(button).to_have_attribute("aria-pressed", "true")
    expect(box.get_by_text(button.get_attribute("title") or "")).to_be_visible()
    assert page.locator("#panel-function input[type=range]").count() == 2
    assert spec_of(page)["monitor"]["u"]["t"] == 0.3
    panel(page, "monitor").get_by_label("Error to make small").select_option("h1")
    expect(box.locator("[data-name=moving-front]")).to_have_attribute("aria-pressed", "true")


def test_a_key_is_sent_with_requests_and_kept_by_the_tab_alone(page: Page) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    box = panel(page, "key")
    box.get_by_label("API key").fill(" emk_of_mine ")
    with page.expect_request("**/v1/previews*") as found:
        page.keyboard.press("Enter")
    assert found.value.headers["authorization"] == "Bearer emk_of_mine"
    assert page.evaluate("sessionStorage.getItem('equimesh-key')") == "emk_of_mine"
    assert page.evaluate("localStorage.length") == 0
    assert "emk_of_mine" not in page.url
    with page.expect_request("**/v1/previews*") as found:
        box.get_by_role("button", name="Forget it").click()
    assert "authorization" not in found.value.headers
    assert page.evaluate("sessionStorage.getItem('equimesh-key')") is None


def test_a_service_that_wants_a_key_opens_the_field(page: Page) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    page.complaints.expected = ["status of 401"]  # type: ignore[attr-defined]
    problem = '{"title": "unauthorized", "detail": "API key required.", "status": 401}'
    page.route("**/v1/previews*", lambda route: route.fulfill(status=401, body=problem))
    details = page.locator("#panel-key details")
    assert details.get_attribute("open") is None
    page.locator("#panel-function textarea").fill("x*y")
    expect(details).to_have_attribute("open", "")
    expect(details.get_by_text("API key required.")).to_be_visible()
