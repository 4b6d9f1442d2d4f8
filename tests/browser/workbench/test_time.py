"""The panel of the time: t in the address, the film of the meshes, and its range."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from browser.workbench.states import has_mesh, panel_at, state

pytestmark = pytest.mark.needs("chromium")
SPEC: dict[str, Any] = {
    "monitor": {"kind": "arc_length", "u": {"expression": "tanh(20*(x - 0.2 - 0.6*t))"}},
    "grid": {"n_xi": 17, "n_eta": 9},
}
COUNT = 5
# Keeps the names that the first button of the player has from now on.
NOTE_BUTTONS = """panel => {
  const button = panel.querySelector(".player button");
  window.buttons = [];
  const note = () => window.buttons.push(button.getAttribute("aria-label"));
  new MutationObserver(note).observe(button, { attributes: true });
}"""


@pytest.fixture
def page(lasting_page: Page) -> Page:
    return lasting_page


def test_a_move_of_the_slider_is_a_time_of_the_spec(page: Page) -> None:
    panel = panel_at(page, "time", SPEC, sliders={"t": {"min": 0, "max": 2, "count": COUNT}})
    has_mesh(page, 17, 9)
    slider = panel.get_by_role("slider")
    slider.focus()
    slider.press("ArrowRight")
    expect(panel.locator(".time-status")).to_have_text("t = 0.5")
    expect(slider).to_have_attribute("aria-valuetext", "t = 0.5")
    assert state(page)["spec"]["monitor"]["u"] == {**SPEC["monitor"]["u"], "t": 0.5}


def test_time_plays_once_over_each_mesh_and_ends_at_the_last_one(page: Page) -> None:
    times: list[float] = []

    def count(request: Any) -> None:
        if "/v1/previews" in request.url:
            u = request.post_data_json["monitor"]["u"]
            times.append(u.get("t", 0) if isinstance(u, dict) else 0)

    panel = panel_at(page, "time", SPEC, sliders={"t": {"min": 0, "max": 1, "count": COUNT}})
    has_mesh(page, 17, 9)
    page.on("request", count)
    panel.get_by_role("combobox").select_option("4")
    panel.get_by_role("button", name="Play the time").click()
    expect(panel.locator(".time-status")).to_have_text("t = 1", timeout=60_000)
    expect(panel.get_by_role("button", name="Play the time")).to_be_visible()
    has_mesh(page, 17, 9)
    assert times[:COUNT] == [0, 0.25, 0.5, 0.75, 1]
    assert times[COUNT:] in ([], [1])  # the mesh of the state where it stops
    assert state(page)["spec"]["monitor"]["u"]["t"] == 1
    panel.evaluate(NOTE_BUTTONS)  # a film that is kept may have ended before a look at the page
    panel.get_by_role("button", name="Play the time").click()
    page.wait_for_function("() => buttons.includes('Pause the time') && buttons.at(-1) === 'Play the time'")
    assert times.count(0.5) == 1  # the film is kept
    page.remove_listener("request", count)


def test_the_nodes_between_two_times_are_on_straight_lines(page: Page) -> None:
    found = page.evaluate("""
        async () => {
          const { between } = await import("./workbench/film.js");
          const array = (...data) => ({ shape: [data.length], data: Float64Array.from(data) });
          const before = { arrays: { x: array(0, 1), q_eq: array(3) } };
          const after = { arrays: { x: array(1, 3), q_eq: array(5) } };
          const { arrays } = between(before, after, 0.75);
          return [[...arrays.x.data], [...arrays.q_eq.data]];
        }
    """)
    assert found == [[0.75, 2.5], [5]]


def test_a_range_that_is_none_is_refused_in_words(page: Page) -> None:
    panel = panel_at(page, "time", SPEC)
    first = panel.get_by_label("from t")
    first.fill("3")
    first.press("Tab")
    expect(panel.locator(".time-status")).to_have_text(re.compile("from a smaller to a larger number"))
    expect(first).to_have_attribute("aria-invalid", "true")
    first.fill("-1")
    first.press("Tab")
    expect(first).not_to_have_attribute("aria-invalid", "true")
    assert state(page)["sliders"]["t"]["min"] == -1


def test_every_function_with_t_gets_the_time(page: Page) -> None:
    found = page.evaluate("""
        async () => {
          const { atTime, timeOf } = await import("./workbench/sources.js");
          const monitors = [{ u: "sin(t*x)" }, { u: { expression: "tan(x)" } }];
          const spec = { monitor: { kind: "intersection", monitors } };
          const later = atTime(spec, 2);
          const without = timeOf({ monitor: { u: "sqrt(x)" } });
          return [timeOf(spec), later.monitor.monitors, atTime(later, null).monitor.monitors, without];
        }
    """)
    assert found[0] == 0
    assert found[1] == [{"u": {"expression": "sin(t*x)", "t": 2}}, {"u": {"expression": "tan(x)"}}]
    assert found[2][0] == {"u": {"expression": "sin(t*x)"}}
    assert found[3] is None


def test_a_function_without_t_has_no_slider(page: Page) -> None:
    panel = panel_at(page, "time", {**SPEC, "monitor": {"kind": "arc_length", "u": "tanh(9*x)"}})
    expect(panel.get_by_role("slider")).to_have_count(0)
    expect(panel.get_by_text("Write t in the function")).to_be_visible()
