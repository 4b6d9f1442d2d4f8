"""The panel of long solves: request, progress, cancel, and the drawing of the mesh."""

from __future__ import annotations

import re
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from browser.workbench.states import has_mesh, panel_at

pytestmark = pytest.mark.needs("chromium")
U = {"expression": "tanh(20*(x - y))"}
# More points than a preview may have; a fast mesh, and one of minutes.
LARGE: dict[str, Any] = {"monitor": {"kind": "arc_length", "u": U}, "grid": {"n_xi": 281, "n_eta": 281}}
LONG: dict[str, Any] = {"monitor": {"kind": "least_error", "u": U}, "grid": {"n_xi": 401, "n_eta": 401}}


@pytest.fixture
def page(lasting_page: Page) -> Page:
    return lasting_page


def meshes(page: Page) -> list[dict[str, Any]]:
    origin = page.evaluate("new URL('./', document.baseURI).href")
    found: list[dict[str, Any]] = httpx.get(f"{origin}v1/meshes?label=workbench").json()["items"]
    return found


def test_a_mesh_too_large_for_a_preview_is_requested_and_drawn(page: Page) -> None:
    panel = panel_at(page, "work", LARGE)
    expect(panel.locator(".work-status")).to_have_text(
        "This mesh is too much for a preview. Request it here.", timeout=30_000
    )
    panel.get_by_role("button", name="Request this mesh").click()
    expect(panel.get_by_role("progressbar")).to_be_visible()
    expect(panel.locator(".work-status")).to_have_text(
        re.compile(r"^Done in \S+ m?s: 281 × 281 points\.$"), timeout=120_000
    )
    expect(panel.get_by_role("progressbar")).to_be_hidden()
    has_mesh(page, 281, 281)
    assert meshes(page)[0]["grid"] == {"n_xi": 281, "n_eta": 281}


def test_a_mesh_of_a_spec_that_was_left_meanwhile_is_not_shown(page: Page) -> None:
    held: list[Any] = []
    panel = panel_at(page, "work", {**LARGE, "grid": {"n_xi": 21, "n_eta": 21}})
    has_mesh(page, 21, 21)
    page.route("**/drawing", lambda route: held.append(route))
    panel.get_by_role("button", name="Request this mesh").click()
    while not held:
        page.wait_for_timeout(50)
    panel_at(page, "work", {**LARGE, "grid": {"n_xi": 19, "n_eta": 19}})
    has_mesh(page, 19, 19)
    held[0].continue_()
    expect(panel.locator(".work-status")).to_contain_text("is not shown")
    has_mesh(page, 19, 19)
    page.unroute("**/drawing")


def test_a_mesh_is_canceled_while_it_is_computed(page: Page) -> None:
    panel = panel_at(page, "work", LONG)
    expect(panel.locator(".work-status")).not_to_be_empty(timeout=30_000)
    panel.get_by_role("button", name="Request this mesh").click()
    cancel = panel.get_by_role("button", name="Cancel")
    expect(cancel).to_be_focused()
    expect(panel.locator(".work-status")).to_have_text(re.compile(r"^\d+ %: "), timeout=60_000)
    assert 0 <= float(panel.get_by_role("progressbar").evaluate("node => node.value")) < 100
    cancel.click()
    expect(panel.locator(".work-status")).to_have_text("Canceled.", timeout=60_000)
    expect(panel.get_by_role("button", name="Request this mesh")).to_be_visible()
    assert meshes(page)[0]["status"] == "canceled"


def test_what_is_wrong_with_a_request_is_shown(page: Page) -> None:
    panel = panel_at(page, "work", {**LARGE, "monitor": {"u": "sin(x*"}})
    panel.get_by_role("button", name="Request this mesh").click()
    expect(panel.get_by_role("alert")).to_have_text(re.compile("something is missing"), timeout=30_000)
    expect(panel.get_by_role("button", name="Request this mesh")).to_be_visible()
