"""The panel of the visitor's own data: files of numbers and pictures become u."""

from __future__ import annotations

import io
import re
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from browser.workbench.states import has_mesh, panel_at, state

pytestmark = pytest.mark.needs("chromium")
SPEC: dict[str, Any] = {
    "monitor": {"kind": "curvature", "u": {"expression": "tanh(9*(x - y))"}},
    "grid": {"n_xi": 17, "n_eta": 9},
}
# Drops a file on the middle of the page, as a visitor does.
DROP = """
(text) => {
  const transfer = new DataTransfer();
  transfer.items.add(new File([text], "dropped.csv", { type: "text/csv" }));
  for (const name of ["dragover", "drop"]) {
    document.body.dispatchEvent(new DragEvent(name, { dataTransfer: transfer, bubbles: true, cancelable: true }));
  }
}
"""


@pytest.fixture
def page(lasting_page: Page) -> Page:
    return lasting_page


def table(bad: str = "") -> str:
    axis = np.linspace(0, 1, 9)
    rows = [f"{x},{y},{np.tanh(9 * (x - y))}" for x in axis for y in axis]
    return "\n".join(["x,y,u", *([bad] if bad else []), *rows])


@pytest.fixture
def panel(page: Page) -> Locator:
    found = panel_at(page, "samples", SPEC)
    has_mesh(page, 17, 9)
    return found


def choose(panel: Locator, name: str, data: bytes, kind: str = "") -> None:
    panel.get_by_label("File of samples, or picture").set_input_files(
        [{"name": name, "mimeType": kind, "buffer": data}]
    )


def stored(page: Page) -> dict[str, Any]:
    """The arrays of the samples that are u."""
    id = state(page)["spec"]["monitor"]["u"]["samples"]
    origin = page.evaluate("new URL('./', document.baseURI).href")
    with np.load(io.BytesIO(httpx.get(f"{origin}v1/samples/{id}?format=npz").content)) as file:
        return dict(file)


def test_a_table_becomes_u_and_is_removed(page: Page, panel: Locator) -> None:
    choose(panel, "front.csv", table().encode(), "text/csv")
    facts = panel.locator(".samples-facts")
    expect(facts).to_contain_text("front.csv", timeout=30_000)
    expect(facts).to_contain_text("9 × 9 (a grid)")
    expect(facts).to_contain_text(re.compile(r"-1\.000 to 1\.000"))
    assert state(page)["spec"]["monitor"]["kind"] == "curvature"
    assert stored(page)["values"].shape == (9, 9)
    has_mesh(page, 17, 9)
    panel.get_by_role("button", name="Remove the samples").click()
    expect(facts).to_be_hidden()
    assert state(page)["spec"]["monitor"] == SPEC["monitor"]


@pytest.mark.parametrize(
    "suffix", ["npz", *(pytest.param(name, marks=pytest.mark.everything) for name in ("npy", "json"))]
)
def test_files_of_arrays_become_u(page: Page, panel: Locator, suffix: str) -> None:
    axis = np.linspace(0, 1, 7)
    values = np.tanh(5 * np.subtract.outer(axis, axis))
    file = io.BytesIO()
    if suffix == "npz":
        np.savez(file, x=axis, y=axis, values=values)
    elif suffix == "npy":
        np.save(file, values)
    else:
        file.write(b'{"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}}')
    choose(panel, f"u.{suffix}", file.getvalue())
    expect(panel.locator(".samples-facts")).to_contain_text(f"u.{suffix}", timeout=30_000)
    assert stored(page)["values"].shape == ((2, 2) if suffix == "json" else (7, 7))


def test_the_page_asks_which_column_is_u(panel: Locator) -> None:
    axis = np.linspace(0, 1, 9)
    rows = [f"{x},{y},{x * y},{np.tanh(9 * (x - y))}" for x in axis for y in axis]
    choose(panel, "flow.csv", "\n".join(["x,y,p,T", *rows]).encode(), "text/csv")
    question = panel.get_by_role("group", name="Columns of the file")
    expect(question).to_contain_text("Which column of flow.csv is u?", timeout=30_000)
    expect(panel.locator(".fault").first).to_be_empty()
    question.get_by_role("button", name="T", exact=True).click()
    expect(panel.locator(".samples-facts")).to_contain_text("-1.000 to 1.000", timeout=30_000)
    expect(question).to_be_hidden()


def test_a_fault_is_shown_with_its_line(page: Page, panel: Locator) -> None:
    choose(panel, "bad.csv", table("0,0.5,abc").encode(), "text/csv")
    expect(panel.get_by_role("alert")).to_have_text(
        re.compile(r"^bad\.csv: line 2 of the csv file: .*abc"), timeout=30_000
    )
    expect(panel.locator(".fault-line")).to_have_text("2: 0,0.5,abc")
    assert state(page)["spec"] == SPEC
    choose(panel, "front.csv", table().encode(), "text/csv")
    expect(panel.locator(".samples-facts")).to_contain_text("front.csv", timeout=30_000)
    expect(panel.get_by_role("alert")).to_have_count(0)
    expect(panel.locator(".fault-line")).to_be_hidden()


def test_a_dropped_file_becomes_u(page: Page, panel: Locator) -> None:
    page.evaluate(DROP, table())
    expect(panel.locator(".samples-facts")).to_contain_text("dropped.csv", timeout=30_000)
    assert "samples" in state(page)["spec"]["monitor"]["u"]


def test_a_picture_becomes_its_grey_values_with_y_upwards(page: Page, panel: Locator) -> None:
    picture = Image.new("RGB", (40, 20), "white")
    picture.paste("black", (0, 0, 10, 5))  # at the top on the left
    picture.paste((255, 0, 0), (30, 15, 40, 20))  # at the bottom on the right
    file = io.BytesIO()
    picture.save(file, "PNG")
    panel.get_by_label("Give the domain the proportions of a picture").check()
    choose(panel, "picture.png", file.getvalue(), "image/png")
    expect(panel.locator(".samples-facts")).to_contain_text("40 × 20 (a grid)", timeout=30_000)
    values = stored(page)["values"]
    assert values.shape == (40, 20)
    assert values[2, 18] == pytest.approx(0)
    assert values[2, 2] == pytest.approx(1)
    assert values[37, 2] == pytest.approx(0.2126, abs=1e-4)
    assert state(page)["spec"]["domain"] == {"kind": "rectangle", "x": [0, 1], "y": [0, 0.5]}
    has_mesh(page, 17, 9)
    panel.get_by_role("button", name="Remove the samples").click()
    assert "domain" not in state(page)["spec"]


@pytest.mark.everything
def test_a_large_picture_is_made_smaller(page: Page, panel: Locator) -> None:
    file = io.BytesIO()
    Image.linear_gradient("L").resize((1200, 600)).save(file, "JPEG")
    choose(panel, "photo.jpg", file.getvalue(), "image/jpeg")
    expect(panel.locator(".samples-facts")).to_contain_text("256 × 128 (a grid)", timeout=30_000)
    values = stored(page)["values"]
    assert values[10, 120] < 0.1 < 0.9 < values[10, 5]  # white below


def test_what_is_no_picture_is_refused_in_the_browser(panel: Locator) -> None:
    choose(panel, "broken.png", b"not a picture", "image/png")
    expect(panel.get_by_role("alert")).to_have_text(
        "broken.png: The browser cannot read this picture. Save it as PNG or JPEG."
    )


def test_a_link_with_samples_says_what_they_are(page: Page, panel: Locator) -> None:
    choose(panel, "front.csv", table().encode(), "text/csv")
    expect(panel.locator(".samples-facts")).to_contain_text("front.csv", timeout=30_000)
    state(page)  # the address has the samples now
    page.reload()
    panel.locator("details").first.evaluate("node => { node.open = true }")
    expect(panel.locator(".samples-facts")).to_contain_text("9 × 9 (a grid)", timeout=30_000)
    assert stored(page)["values"].shape == (9, 9)
