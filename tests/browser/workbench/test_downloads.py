"""The panel of downloads: the mesh in every format, the picture, the spec, and what goes wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from browser.workbench.panels import panel

pytestmark = pytest.mark.needs("chromium")


def saved(page: Page, name: str) -> Path:
    with page.expect_download() as found:
        panel(page, "downloads").get_by_role("button", name=name, exact=True).click()
    return Path(found.value.path())


def test_every_format_is_downloaded_of_one_mesh(page: Page, page_url: str) -> None:
    expect(page.locator("#status")).to_contain_text("17")
    formats = httpx.get(f"{page_url}/v1/capabilities").json()["formats"]
    before = httpx.get(f"{page_url}/v1/meshes?label=workbench&limit=200").json()["items"]
    for one in formats:
        file = saved(page, f"Download the mesh as {one['name']}")
        assert file.stat().st_size > 500
    after = httpx.get(f"{page_url}/v1/meshes?label=workbench&limit=200").json()["items"]
    assert len(after) == len(before) + 1
    for one in formats:
        served = httpx.get(f"{page_url}/v1/meshes/{after[0]['id']}/file?format={one['name']}").content
        assert saved(page, f"Download the mesh as {one['name']}").read_bytes() == served
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
