"""The panel to draw a density: strokes by mouse, touch and keyboard become a weight monitor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

import equimesh as em
from browser.workbench.states import has_mesh, panel_at, state, state_now
from equimesh import specs

pytestmark = pytest.mark.needs("chromium")
SPEC: dict[str, Any] = {
    "monitor": {"kind": "arc_length", "u": {"expression": "x + y"}},
    "domain": {"kind": "rectangle", "x": [0, 2], "y": [0, 1]},
    "grid": {"n_xi": 17, "n_eta": 17},
}


@pytest.fixture
def panel(page: Page) -> Locator:
    found = panel_at(page, "sketch", SPEC, view={"layout": "one"})
    has_mesh(page, 17, 17)
    found.get_by_role("button", name="Draw on the mesh").click()
    expect(surface(page)).to_be_visible()
    return found


def surface(page: Page) -> Locator:
    return page.locator("canvas.surface")


def density(page: Page) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The samples of rho in the address; empty where there is none."""
    rho = state_now(page)["spec"]["monitor"].get("rho")
    return np.array(rho["grid"]["values"]) if rho else np.zeros(0)


def until(page: Page, holds: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The density as soon as it is as expected."""
    for _ in range(100):
        found = density(page)
        if holds(found):
            return found
        page.wait_for_timeout(50)
    raise AssertionError(f"the density lies between {found.min()} and {found.max()}")


def place_of(page: Page, x: float, y: float) -> tuple[float, float]:
    """The pixel of a point of the domain, which fills the pane but for its margin."""
    box = surface(page).bounding_box()
    assert box
    scale = 0.94 * min(box["width"] / 2, box["height"])
    return box["x"] + box["width"] / 2 + (x - 1) * scale, box["y"] + box["height"] / 2 - (y - 0.5) * scale


@pytest.mark.usefixtures("panel")
def test_a_stroke_of_the_mouse_makes_cells_small_there(page: Page) -> None:
    page.mouse.move(*place_of(page, 0.5, 0.2))
    page.mouse.down()
    page.mouse.move(*place_of(page, 0.5, 0.8), steps=4)
    page.mouse.up()
    values = until(page, lambda found: found.size and found.max() > 3)
    assert values.shape == (33, 33)
    i, j = np.unravel_index(values.argmax(), values.shape)
    assert abs(i / 32 - 0.25) < 0.06  # x = 0.5 of 2
    assert 0.1 < j / 32 < 0.9
    assert values[24].max() == 1
    monitor = state(page)["spec"]["monitor"]
    assert "u" not in monitor  # the mesh is not to blame for the error of a function that it does not follow
    expect(page.locator("#headline")).to_have_text("The mesh follows the density that you drew.")
    assert monitor["rho"]["grid"]["x"][-1] == 2
    mesh = em.solve(specs.build(state(page)["spec"]).problem).mesh
    assert np.diff(mesh.x[:, 8]).min() < 0.7 * 2 / 16
    has_mesh(page, 17, 17)


def test_strokes_are_taken_back_cleared_and_erased(page: Page, panel: Locator) -> None:
    for x in (0.5, 1.5):
        page.mouse.click(*place_of(page, x, 0.5))
    until(page, lambda found: found.size and min(found[:16].max(), found[17:].max()) > 2)
    panel.get_by_role("button", name="Undo").click()
    until(page, lambda found: found[17:].max() == 1 and found[:16].max() > 2)
    page.mouse.click(*place_of(page, 1.5, 0.5))
    until(page, lambda found: found[17:].max() > 2)
    erase = panel.get_by_role("button", name="Erase")
    erase.click()
    expect(erase).to_have_attribute("aria-pressed", "true")
    page.mouse.click(*place_of(page, 0.5, 0.5))
    until(page, lambda found: found[:16].max() < 2.5 and found[17:].max() > 2)
    panel.get_by_role("button", name="Clear").click()
    until(page, lambda found: found.max() == 1)
    expect(panel.get_by_role("button", name="Clear")).to_be_disabled()
    panel.get_by_role("button", name="Undo").click()
    until(page, lambda found: found[17:].max() > 2)
    panel.get_by_role("button", name="Back to the function").click()
    expect(surface(page)).to_be_hidden()
    assert state(page)["spec"]["monitor"] == SPEC["monitor"]


@pytest.mark.everything
def test_the_brush_has_a_size_and_a_strength(page: Page, panel: Locator) -> None:
    page.mouse.click(*place_of(page, 1, 0.5))
    narrow = until(page, lambda found: found.size and found.max() > 2)
    panel.get_by_role("button", name="Undo").click()
    panel.get_by_label("Size of the brush").fill("0.2")
    panel.get_by_label("Strength").fill("20")
    page.mouse.click(*place_of(page, 1, 0.5))
    wide = until(page, lambda found: found.max() > 15)
    assert (wide > 2).sum() > 3 * (narrow > 2).sum()


def test_a_keyboard_draws(page: Page, panel: Locator) -> None:
    expect(surface(page)).to_be_focused()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Space")
    values = until(page, lambda found: found.size and found.max() > 2)
    i, j = np.unravel_index(values.argmax(), values.shape)
    assert (i > 16, j) == (True, 16)
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Enter")
    until(page, lambda found: found[i, 17] > values[i, 17])
    page.keyboard.press("z")
    page.keyboard.press("z")
    until(page, lambda found: found.max() == 1)
    page.keyboard.press("e")
    expect(panel.get_by_role("button", name="Erase")).to_have_attribute("aria-pressed", "true")
    page.keyboard.press("Escape")
    expect(surface(page)).to_be_hidden()
    expect(panel.get_by_role("button", name="Draw on the mesh")).to_be_focused()


@pytest.mark.usefixtures("panel")
def test_a_finger_draws_and_does_not_scroll(page: Page) -> None:
    x, y = place_of(page, 1, 0.5)
    surface(page).dispatch_event(
        "pointerdown",
        {"pointerId": 1, "pointerType": "touch", "button": 0, "clientX": x, "clientY": y, "isPrimary": True},
    )
    surface(page).dispatch_event("pointerup", {"pointerId": 1, "pointerType": "touch"})
    until(page, lambda found: found.size and found.max() > 2)
    assert surface(page).evaluate("node => getComputedStyle(node).touchAction") == "none"


@pytest.mark.usefixtures("panel")
@pytest.mark.everything
def test_another_domain_keeps_the_density(page: Page) -> None:
    page.mouse.click(*place_of(page, 1, 0.5))
    until(page, lambda found: found.size and found.max() > 2)
    spec = state(page)["spec"]
    panel_at(page, "sketch", {**spec, "domain": {"kind": "annulus_sector"}})
    for _ in range(100):
        rho = state_now(page)["spec"]["monitor"]["rho"]["grid"]
        if [rho["x"][-1], rho["y"][-1]] == [2, 2]:
            break
        page.wait_for_timeout(50)
    assert [rho["x"][0], rho["x"][-1], rho["y"][0], rho["y"][-1]] == pytest.approx([0, 2, 0, 2])
    assert np.array(rho["values"]).max() > 2
    has_mesh(page, 17, 17)
