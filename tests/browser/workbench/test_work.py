"""The panel of long solves: request, progress, cancel, and the drawing of the mesh."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from browser.workbench.panels import panel
from browser.workbench.states import has_mesh, panel_at

pytestmark = pytest.mark.needs("chromium")
U = {"expression": "tanh(20*(x - y))"}
# More points than a preview may have; a fast mesh, and one of minutes.
LARGE: dict[str, Any] = {"monitor": {"kind": "arc_length", "u": U}, "grid": {"n_xi": 281, "n_eta": 281}}
LONG: dict[str, Any] = {"monitor": {"kind": "least_error", "u": U}, "grid": {"n_xi": 401, "n_eta": 401}}


@pytest.fixture
def solving_page(lasting_page: Page) -> Page:
    return lasting_page


def meshes(solving_page: Page) -> list[dict[str, Any]]:
    origin = solving_page.evaluate("new URL('./', document.baseURI).href")
    found: list[dict[str, Any]] = httpx.get(f"{origin}v1/meshes?label=workbench").json()["items"]
    return found


def test_a_mesh_too_large_for_a_preview_is_requested_and_drawn(solving_page: Page) -> None:
    panel = panel_at(solving_page, "work", LARGE)
    expect(panel.locator(".work-status")).to_have_text(
        "This mesh is too much for a preview. Request it here.", timeout=30_000
    )
    panel.get_by_role("button", name="Request this mesh").click()
    expect(panel.get_by_role("progressbar")).to_be_visible()
    expect(panel.locator(".work-status")).to_have_text(
        re.compile(r"^Done in \S+ m?s: 281 × 281 points\.$"), timeout=120_000
    )
    expect(panel.get_by_role("progressbar")).to_be_hidden()
    has_mesh(solving_page, 281, 281)
    assert meshes(solving_page)[0]["grid"] == {"n_xi": 281, "n_eta": 281}


def test_a_mesh_of_a_spec_that_was_left_meanwhile_is_not_shown(solving_page: Page) -> None:
    held: list[Any] = []
    panel = panel_at(solving_page, "work", {**LARGE, "grid": {"n_xi": 21, "n_eta": 21}})
    has_mesh(solving_page, 21, 21)
    solving_page.route("**/drawing", lambda route: held.append(route))
    panel.get_by_role("button", name="Request this mesh").click()
    while not held:
        solving_page.wait_for_timeout(50)
    panel_at(solving_page, "work", {**LARGE, "grid": {"n_xi": 19, "n_eta": 19}})
    has_mesh(solving_page, 19, 19)
    held[0].continue_()
    expect(panel.locator(".work-status")).to_contain_text("is not shown")
    has_mesh(solving_page, 19, 19)
    solving_page.unroute("**/drawing")


def test_a_mesh_is_canceled_while_it_is_computed(solving_page: Page) -> None:
    panel = panel_at(solving_page, "work", LONG)
    expect(panel.locator(".work-status")).not_to_be_empty(timeout=30_000)
    panel.get_by_role("button", name="Request this mesh").click()
    cancel = panel.get_by_role("button", name="Cancel")
    expect(cancel).to_be_focused()
    expect(panel.locator(".work-status")).to_have_text(re.compile(r"^\d+ %: "), timeout=60_000)
    assert 0 <= float(panel.get_by_role("progressbar").evaluate("node => node.value")) < 100
    cancel.click()
    expect(panel.locator(".work-status")).to_have_text("Canceled.", timeout=60_000)
    expect(panel.get_by_role("button", name="Request this mesh")).to_be_visible()
    assert meshes(solving_page)[0]["status"] == "canceled"


def test_what_is_wrong_with_a_request_is_shown(solving_page: Page) -> None:
    panel = panel_at(solving_page, "work", {**LARGE, "monitor": {"u": "sin(x*"}})
    panel.get_by_role("button", name="Request this mesh").click()
    expect(panel.get_by_role("alert")).to_have_text(re.compile("something is missing"), timeout=30_000)
    expect(panel.get_by_role("button", name="Request this mesh")).to_be_visible()


def saved(page: Page, name: str) -> Path:
    with page.expect_download() as found:
        panel(page, "downloads").get_by_role("button", name=name, exact=True).click()
    return Path(found.value.path())


def test_formats_are_downloaded_of_one_mesh(page: Page, page_url: str) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    formats = httpx.get(f"{page_url}/v1/capabilities").json()["formats"]
    before = httpx.get(f"{page_url}/v1/meshes?label=workbench&limit=200").json()["items"]
    for one in (formats[0], formats[-1]):
        file = saved(page, f"Download the mesh as {one['name']}")
        after = httpx.get(f"{page_url}/v1/meshes?label=workbench&limit=200").json()["items"]
        assert len(after) == len(before) + 1
        served = httpx.get(f"{page_url}/v1/meshes/{after[0]['id']}/file?format={one['name']}").content
        assert file.read_bytes() == served
    assert np.load(BytesIO(served))["x"].shape == (17, 17)  # the last format is npz
    expect(panel(page, "downloads").get_by_text("mesh.npz is downloaded.")).to_be_visible()


def test_pictures_and_the_spec_are_saved(page: Page) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    assert saved(page, "PNG").read_bytes().startswith(b"\x89PNG")
    assert saved(page, "SVG").read_text().startswith("<svg")
    assert json.loads(saved(page, "Spec (JSON)").read_text())["grid"] == {"n_xi": 17, "n_eta": 17}


def test_the_mesh_is_downloaded_next_to_it(page: Page) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    row = page.locator("#panel-take")
    row.get_by_label("Format of the file").select_option("msh")
    with page.expect_download() as found:
        row.get_by_role("button", name="Download").click()
    assert found.value.suggested_filename == "mesh.msh"
    expect(row).to_contain_text("mesh.msh is downloaded.")


def test_what_is_wrong_is_told(visit: Callable[..., Page]) -> None:
    page = visit("/#u=sin(x*&n=17&monitor=arc_length")
    box = panel(page, "downloads")
    box.get_by_role("button", name="Download the mesh as vtu").click()
    expect(box.locator(".fault")).to_contain_text("something is missing after")


def test_a_computation_can_be_canceled(page: Page) -> None:
    # The request for the mesh is held back, so that there is time.
    page.route("**/v1/meshes", lambda _: None)
    box = panel(page, "downloads")
    box.get_by_role("button", name="Download the mesh as vtu").click()
    expect(box.get_by_text("Computing the mesh")).to_be_visible()
    box.get_by_role("button", name="Cancel").click()
    expect(box.get_by_text("Canceled.")).to_be_visible()
    expect(box.get_by_role("button", name="Cancel")).to_be_hidden()
