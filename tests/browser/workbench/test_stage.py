"""The figure: colours, the slider between both meshes, cells and their numbers, zoom, frames and pictures."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.needs("chromium")
STAGE = "#stage"
DRAWN = "#stage[data-quick=false]"
COLOUR = "Colour by"
# Frames while the slider between the meshes is moved twenty times, the changes, their milliseconds, and the triangles
# of each frame.
DRAG = """async () => {
  const slider = document.querySelector("#panel-view input[type=range]");
  const stage = document.querySelector("#stage");
  const first = Number(stage.dataset.frames);
  const began = performance.now();
  let asked = 0;
  const triangles = [];
  while (asked < 20) {
    slider.value = 0.5 + 0.5 * Math.sin(asked / 10);
    slider.dispatchEvent(new InputEvent("input", { bubbles: true }));
    asked += 1;
    await new Promise((done) => setTimeout(done)); // listeners of the state are called before the next frame
    await new Promise(requestAnimationFrame);
    triangles.push(Number(stage.dataset.triangles));
  }
  return [Number(stage.dataset.frames) - first, asked, performance.now() - began, triangles];
}"""


def pixels(page: Page, tmp_path: Path) -> Any:
    """The colours of the figure as it is seen, (height, width, 3)."""
    path = tmp_path / "stage.png"
    page.locator(STAGE).screenshot(path=path)
    return imread(path)[:, :, :3]


@pytest.mark.parametrize(
    ("query", "colour"),
    [
        ("", "u"),
        ("?plain", "error"),
        *[
            pytest.param(query, colour, marks=pytest.mark.everything)
            for query in ("", "?plain")
            for colour in ("u", "q_eq", "error", "size", "none")
            if (query, colour) not in {("", "u"), ("?plain", "error")}
        ],
    ],
)
def test_colours_are_drawn_with_a_legend(
    request: pytest.FixtureRequest, tmp_path: Path, query: str, colour: str
) -> None:
    page = request.getfixturevalue("visit" if query else "visit_webgl")(
        f"/{query}#u=tanh(20*(x-y))&n=17&monitor=arc_length"
    )
    page.wait_for_selector(DRAWN)
    # A canvas that is drawn on in another way gives no context of WebGL.
    assert page.evaluate("() => document.querySelector('#mesh').getContext('webgl2') !== null") is (not query)
    page.get_by_label(COLOUR).select_option(colour)
    expect(page.locator(".legend canvas")).to_be_visible(visible=colour != "none")
    seen = pixels(page, tmp_path)
    shades = {tuple(shade) for shade in (seen[60:-60:3, ::3].reshape(-1, 3) * 15).astype(int)}
    assert len(shades) > (20 if colour != "none" else 2)
    assert page.evaluate("() => location.hash").count("view=") == 0 or colour != "error"


def test_both_meshes_have_the_same_scale_and_the_slider_moves_one(
    visit_webgl: Callable[..., Page], tmp_path: Path
) -> None:
    page = visit_webgl("/#u=tanh(20*(x-y))&n=17&monitor=arc_length")
    page.wait_for_selector(DRAWN)
    halves = lambda: np.array_split(pixels(page, tmp_path)[40:-8], 2, axis=1)  # noqa: E731
    left, right = halves()
    slider = page.get_by_role("slider", name="uniform")
    slider.fill("0")
    expect(page.locator("#captions")).to_have_text(re.compile("uniform.*uniform"))
    left_after, right_after = halves()
    assert np.abs(left - left_after).max() < 0.02
    assert np.abs(right - right_after).max() > 0.3
    slider.fill("0.5")
    expect(page.locator("#captions")).to_contain_text("50 % of the way")


def test_a_cell_tells_its_numbers_to_pointer_and_keys(page: Page) -> None:
    page.wait_for_selector(DRAWN)
    box = page.locator(STAGE).bounding_box()
    tip = page.locator("#tip")
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.5 * box["height"])
    for word in ("cell ", "size ", "u ", "error ", "Q_eq "):
        expect(tip).to_contain_text(word)
    page.mouse.move(5, 5)
    expect(tip).to_be_hidden()
    page.locator(STAGE).focus()
    page.keyboard.press("ArrowRight")
    expect(tip).to_contain_text("cell 8, 8 ")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowUp")
    expect(tip).to_contain_text("cell 9, 9 ")
    expect(page.locator("#live")).to_contain_text("cell 9, 9 ")
    page.keyboard.press("Escape")
    expect(tip).to_be_hidden()


def test_wheel_keys_and_buttons_zoom_and_drag_pans(page: Page) -> None:
    page.wait_for_selector(DRAWN)
    stage = page.locator(STAGE)
    zoomed = re.compile(r"\bzoomed\b")
    box = stage.bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.wheel(0, -400)
    expect(stage).to_have_class(zoomed)
    stage.focus()
    page.keyboard.press("ArrowRight")
    cell = page.locator("#overlay .cell").last
    before = cell.get_attribute("points")
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.4 * box["height"])
    page.mouse.up()
    assert cell.get_attribute("points") != before
    page.keyboard.press("0")
    expect(stage).not_to_have_class(zoomed)
    page.get_by_role("button", name="Zoom in").click()
    expect(stage).to_have_class(zoomed)
    page.get_by_role("button", name="Show the whole domain").click()
    expect(stage).not_to_have_class(zoomed)
    page.keyboard.press("0")


@pytest.mark.everything  # it draws by software where there is no graphics card
def test_a_large_mesh_is_dragged_at_the_rate_of_the_screen(
    visit_webgl: Callable[..., Page], capsys: pytest.CaptureFixture[str]
) -> None:
    page = visit_webgl("/#u=tanh(20*(x-y**2))&n=257&monitor=arc_length")
    page.wait_for_selector(DRAWN)
    assert page.get_attribute(STAGE, "data-points") == "257 257"
    uploads = page.get_attribute(STAGE, "data-uploads")
    stage = page.locator(STAGE)
    all_cells = str(2 * 2 * 256 * 256)  # two triangles of a cell, two meshes
    expect(stage).to_have_attribute("data-triangles", all_cells)
    address = page.evaluate("location.hash")
    frames, asked, milliseconds, triangles = page.evaluate(DRAG)
    with capsys.disabled():
        print(f"\nframes a second at 257 x 257, in software: {1000 * frames / milliseconds:.0f} of {asked} changes")
    assert frames >= asked - 2  # one for each change: none is left out
    assert set(triangles) == {int(all_cells) // 8**2}  # the processor draws: 8 x 8 cells are one while they move
    expect(stage).to_have_attribute("data-triangles", all_cells)  # all of them at rest
    expect(page.locator("#captions")).to_contain_text("% of the way")
    page.wait_for_function("address => location.hash !== address", arg=address)
    box = stage.bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.wheel(0, -900)
    expect(stage).to_have_attribute("data-stride", "1")
    page.wait_for_function("all => 4 * document.querySelector('#stage').dataset.triangles < all", arg=int(all_cells))
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.4 * box["height"], steps=5)
    page.mouse.up()
    assert page.get_attribute(STAGE, "data-uploads") == uploads  # nodes stay where they are


@pytest.mark.parametrize("layout", ["both meshes", pytest.param("one mesh", marks=pytest.mark.everything)])
def test_pictures_show_what_is_seen(page: Page, tmp_path: Path, layout: str) -> None:
    page.wait_for_selector(DRAWN)
    page.get_by_role("button", name=layout).click()
    with page.expect_download() as svg:
        page.get_by_role("button", name="Save SVG").click()
    text = svg.value.path().read_text()
    assert page.locator("#headline").inner_text() in text  # the gain
    assert "uniform, interpolation error" in text or layout == "one mesh"
    assert "adapted, interpolation error" in text
    assert "square-root scale" in text
    panes = 2 if layout == "both meshes" else 1
    assert text.count("<clipPath") == panes
    assert len(re.findall(r"M[^M\"]+Z", text)) == panes * 16 * 16
    with page.expect_download() as png:
        page.get_by_role("button", name="Save PNG").click()
    png.value.save_as(tmp_path / "mesh.png")
    seen, saved = pixels(page, tmp_path), imread(tmp_path / "mesh.png")[:, :, :3]
    assert saved.shape[1] < seen.shape[1]  # without the empty margins
    assert coloured(saved) == pytest.approx(coloured(seen), rel=0.15)


def coloured(picture: np.ndarray) -> int:
    """How many pixels have a colour."""
    return int((np.ptp(picture, axis=2) > 0.1).sum())
