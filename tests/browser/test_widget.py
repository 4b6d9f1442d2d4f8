"""The widget of notebooks in a browser, with a model as anywidget has it."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from equimesh.specs.widget import module_text

pytestmark = pytest.mark.needs("chromium")
SHOW = """async ([code, state]) => {
  const { default: widget } = await import("data:text/javascript;charset=utf-8," + encodeURIComponent(code));
  const listeners = new Set();
  window.model = {
    state,
    saved: 0,
    get: () => window.model.state,
    set(_, value) { window.model.state = value; listeners.forEach((tell) => tell()); },
    save_changes() { window.model.saved += 1; },
    on: (_, tell) => listeners.add(tell),
    off: (_, tell) => listeners.delete(tell),
  };
  const el = document.createElement("div"); // Jupyter adds it to the page afterwards
  window.end = widget.render({ model: window.model, el });
  document.body.append(el);
  window.listeners = listeners;
}"""
DRAWN = """[...document.querySelectorAll("canvas")].map((canvas) =>
  canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((part) => part > 0))"""
STATE = {
    "formula": "tanh(k*(x - y))",
    "parameters": {"k": 10},
    "ranges": {"k": {"min": 0, "max": 20}},
    "domain": {"x": [0, 1], "y": [0, 1]},
    "shape": [9, 9],
    "method": "least_error",
}


def test_sliders_and_python_change_one_state(chromium: Browser) -> None:
    page = chromium.new_page()
    faults: list[str] = []
    page.on("pageerror", lambda fault: faults.append(str(fault)))
    page.evaluate(SHOW, [module_text(), STATE])
    settled = page.locator("[data-state=settled]")
    settled.wait_for()
    assert page.get_by_role("combobox").count() == 0
    slider = page.get_by_role("slider", name="k")
    slider.press("ArrowRight")
    settled.wait_for()
    assert page.evaluate("model.state.parameters.k") == 10.1
    assert page.evaluate("model.saved") == 1
    page.evaluate("model.set('state', { ...model.state, formula: 'sin(k*x)', parameters: { k: 3 } })")
    settled.wait_for()
    assert page.get_by_label("u(x, y) =").input_value() == "sin(k*x)"
    assert slider.input_value() == "3"
    assert page.evaluate("model.saved") == 1
    assert slider.get_attribute("data-lm-suppress-shortcuts") == "true"
    assert page.evaluate(DRAWN) == [True, True]
    assert page.evaluate("(end(), listeners.size)") == 0
    assert faults == []
    page.close()
