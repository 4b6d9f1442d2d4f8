"""The page as a whole: what axe finds, sizes of screens, the keyboard, addresses, and words about the result."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from urllib.parse import unquote

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.needs("chromium")
SMALL = "/#u=tanh(20*(x-y))&n=17&monitor=arc_length"
DRAWN = "#stage[data-quick=false]"
UNFOLD = "() => document.querySelectorAll('aside details').forEach((each) => (each.open = true))"
SCREENS = {"phone": (390, 844), "laptop": (1366, 768), "wide": (1920, 1080)}


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.everything)])
def test_axe_finds_nothing(visit: Callable[..., Page], scheme: str) -> None:
    page = visit(SMALL, color_scheme=scheme, bypass_csp=True)
    page.wait_for_selector(DRAWN)
    page.evaluate(UNFOLD)
    page.fill("#panel-function textarea", "sin(x*")
    expect(page.locator("#panel-function .fault")).not_to_be_empty()
    results = Axe().run(page)
    assert [each["id"] for each in results.response["violations"]] == [], results.generate_report()


@pytest.mark.parametrize("screen", SCREENS)
def test_nothing_is_wider_than_the_screen(visit: Callable[..., Page], screen: str) -> None:
    width, height = SCREENS[screen]
    page = visit(SMALL, viewport={"width": width, "height": height}, has_touch=screen == "phone")
    page.wait_for_selector(DRAWN)
    page.evaluate(UNFOLD)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    assert page.locator("#headline").bounding_box()["y"] < height / 2  # type: ignore[index]


def test_the_first_mesh_needs_no_action(visit: Callable[..., Page]) -> None:
    page = visit("/")
    page.wait_for_selector("#stage[data-quick]")
    expect(page.locator("#headline")).to_have_text(re.compile(r"\d times smaller than on a uniform mesh"))
    expect(page.locator("#headline")).to_have_class(re.compile("good"))


def test_a_mesh_that_is_worse_is_said_in_red(visit: Callable[..., Page]) -> None:
    page = visit(
        "/#" + 'spec={"monitor":{"kind":"weight","rho":"1+50*x","u":"exp(-8*x)"},"grid":{"n_xi":17,"n_eta":17}}'
    )
    expect(page.locator("#headline")).to_have_class(re.compile("bad"))
    expect(page.locator("#headline")).to_contain_text("larger than on a uniform mesh")


def test_the_result_is_announced(page: Page) -> None:
    page.wait_for_selector(DRAWN)
    expect(page.locator("#live")).to_have_text(page.locator("#headline").inner_text())


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


def test_an_address_that_cannot_be_read_opens_the_page(visit: Callable[..., Page]) -> None:
    page = visit('/#spec={"monitor&view=7&sliders=[]')
    page.wait_for_selector("#stage[data-quick]")
