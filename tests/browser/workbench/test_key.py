"""The field of the API key: it goes to the service, and no further than the tab."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from browser.workbench.panels import panel

pytestmark = pytest.mark.needs("chromium")


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
