"""Live: from a key to a mesh, answers in order, faults with a caret, parameters with sliders."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
from playwright.sync_api import Page, Request, expect

from browser.workbench.states import has_mesh, panel_at
from equimesh_service.worker.drawing import pack

pytestmark = pytest.mark.needs("chromium")
FUNCTION = "#panel-function textarea"
QUICK = "#stage[data-quick]"
# Milliseconds from the last key to the frame with its mesh, for each of some keys; runs in the page.
TYPE = """async (texts) => {
  const field = document.querySelector("#panel-function textarea");
  const stage = document.querySelector("#stage");
  const times = [];
  for (const text of texts) {
    const before = Number(stage.dataset.drawings);
    const began = performance.now();
    field.value = text;
    field.dispatchEvent(new InputEvent("input", { bubbles: true }));
    while (Number(stage.dataset.drawings) === before) await new Promise(requestAnimationFrame);
    times.push(performance.now() - began);
    await new Promise((done) => setTimeout(done, 300));
  }
  return times;
}"""

# Whether the error in the caption of the adapted mesh is smaller than in that of the uniform one.
GAINS = """() => {
  const [uniform, adapted] = document.querySelector("#captions").innerText.match(/[0-9.e-]+(?=\\s|$)/g).map(Number);
  return 0 < adapted && adapted < uniform;
}"""
# Notes for each drawing whether it is a quick look, whether the numbers say so, and whether the headline has a gain.
WATCH = """() => {
  window.seen = [];
  const stage = document.querySelector("#stage");
  const says = () => document.querySelector("#panel-numbers").textContent.includes("quick look");
  const counts = () => document.querySelector("#headline").textContent.includes("times smaller");
  const note = () => window.seen.push([stage.dataset.quick, says(), counts()]);
  new MutationObserver(note).observe(stage, { attributeFilter: ["data-drawings"] });
}"""


def specs_of(page: Page) -> list[Any]:
    """The specs of all previews that the page requests from now on."""
    specs: list[Any] = []

    def note(request: Request) -> None:
        if request.url.endswith("/v1/previews"):
            specs.append(json.loads(request.post_data or "null"))

    page.on("request", note)
    return specs


def least_error_spec(norm: str) -> str:
    """A small mesh of least error, as a part of an address."""
    monitor = {"kind": "least_error", "norm": norm, "u": "tanh(20*(x-y**2))"}
    return quote(json.dumps({"monitor": monitor, "grid": {"n_xi": 17, "n_eta": 17}}))


def test_a_mesh_follows_each_key(visit: Callable[..., Page], capsys: pytest.CaptureFixture[str]) -> None:
    page = visit("/#u=tanh(20*(x-y))&n=33&monitor=arc_length")
    page.wait_for_selector(QUICK)
    specs = specs_of(page)
    texts = [f"tanh({k}*(x - y**2))" for k in range(10, 15)]
    times = page.evaluate(TYPE, texts)
    assert [spec["monitor"]["u"]["expression"] for spec in specs] == texts
    assert {(spec["grid"]["n_xi"], spec["grid"]["n_eta"]) for spec in specs} == {(33, 33)}
    with capsys.disabled():
        print(f"\nfrom a key to its mesh, 33 x 33: median {statistics.median(times):.0f} ms, least {min(times):.0f} ms")


@pytest.mark.parametrize(
    ("norm", "kinds"),
    [("l2", ["least_error"]), pytest.param("h1", ["arc_length", "least_error"], marks=pytest.mark.everything)],
)
def test_a_slow_mesh_is_shown_after_a_quick_look(visit: Callable[..., Page], norm: str, kinds: list[str]) -> None:
    """The page computes the first look itself, except for meshes that its kernel does not make."""
    page = visit(f"/#spec={least_error_spec(norm)}")
    page.wait_for_selector("#stage[data-quick=false]")
    refused: list[int] = []
    page.on("response", lambda response: refused.append(response.status) if response.status in (429, 503) else None)
    specs = specs_of(page)
    page.evaluate(WATCH)
    for steepness in range(12, 20):
        specs.clear()
        refused.clear()
        page.evaluate("() => { window.seen = []; }")
        page.fill(FUNCTION, f"tanh({steepness}*(x-y**2))")
        page.wait_for_function("() => window.seen.at(-1)?.[0] === 'false'")
        if not refused:  # the page omits the quick look that a busy service refuses
            break
    seen = page.evaluate("() => window.seen")
    assert (seen[0], seen[-1]) == (["true", True, False], ["false", False, True])
    assert [*dict.fromkeys(spec["monitor"].get("kind") for spec in specs)] == kinds


@pytest.mark.parametrize("kind", [pytest.param("auto", marks=pytest.mark.everything), "arc_length"])
def test_a_key_is_answered_by_the_page_where_the_service_is_far(visit: Callable[..., Page], kind: str) -> None:
    page = visit(f"/#u=tanh(20*(x-y))&n=17&monitor={kind}")
    page.wait_for_selector("#stage[data-quick=false]")
    held: list[Any] = []

    def hold(route: Any) -> None:
        held.append(route)

    page.route("**/v1/previews", hold)
    page.fill(FUNCTION, "tanh(15*(x-y**2))")
    page.wait_for_selector("#stage[data-quick=true]")
    expect(page.locator("#headline")).to_contain_text("A first look that this page computes itself.")
    expect(page.locator("#status")).to_contain_text("First look of the page of 17 × 17 points")
    page.wait_for_function(GAINS)  # the first step from the mesh before may be worse yet
    while not held:
        page.wait_for_timeout(50)
    held[-1].continue_()
    page.wait_for_selector("#stage[data-quick=false]")
    expect(page.locator("#status")).to_contain_text("Mesh of 17 × 17 points")


def test_a_quick_look_at_blocks_is_one_descent_on_fewer_cells(page: Page) -> None:
    def spec(kind: str | None, domain: dict[str, Any]) -> dict[str, Any]:
        return {"monitor": {"u": "x", **({"kind": kind} if kind else {})}, "domain": domain}

    few, many, file = (
        {"kind": "blocks", "blocks": [{"cells": [20, 30]}]},
        {"kind": "blocks", "blocks": [{"cells": [40, None]}, {"cells": [60, 56]}], "refine": 2},
        {"kind": "mesh", "file": "s-1"},
    )
    specs = [spec(None, few), spec("least_error", few), spec("auto", many), spec("auto", file), spec("weight", few)]
    wrong = {"monitor": {"u": "x"}, "grid": {"n_xi": 3}}
    specs.append(wrong)
    code = "async (specs) => { const { quickSpec } = await import('/workbench/live.js'); return specs.map(quickSpec); }"
    least = {"kind": "least_error", "u": "x", "norm": "l2"}
    fewer = {**many, "refine": 0.5}  # 4 * (640 + 3360) cells are 16 times too many
    assert page.evaluate(code, specs) == [
        {"monitor": least, "domain": few},
        None,
        {"monitor": least, "domain": fewer},
        {"monitor": least, "domain": file},
        None,
        None,  # a grid that the service refuses
    ]


def test_an_old_answer_never_replaces_a_newer_one(page: Page) -> None:
    page.wait_for_selector(QUICK)
    held = []

    def answer(route: Any) -> None:
        if "11*" in (route.request.post_data or ""):
            held.append(route)
        else:
            route.continue_()

    page.route("**/v1/previews", answer)
    page.fill(FUNCTION, "tanh(11*x)")
    page.wait_for_selector("#stage[data-quick=true]")  # what the page shows itself
    page.wait_for_timeout(200)  # longer than the page waits for an answer before it gives the request up
    page.fill(FUNCTION, "tanh(12*x)")
    page.wait_for_selector("#stage[data-quick=false]")
    before = page.get_attribute("#stage", "data-drawings")
    assert len(held) == 1
    held[0].continue_()
    page.wait_for_timeout(400)
    assert page.get_attribute("#stage", "data-drawings") == before


def test_a_caret_stands_under_what_is_wrong_and_nothing_is_computed_of_it(page: Page) -> None:
    page.wait_for_selector(QUICK)
    fault = page.locator("#panel-function .fault")
    for text, column, words in (
        ("sin(x*", 7, "something is missing"),
        ("x 2", 3, "no operator"),
        ("1/0 + x", 1, "not finite"),
    ):
        page.fill(FUNCTION, text)
        expect(fault).to_contain_text(words)
        assert page.locator(".caret").text_content() == " " * (column - 1) + "^"
        expect(page.locator(FUNCTION)).to_have_attribute("aria-invalid", "true")
        expect(page.locator("#stage")).to_have_class("stale")
        page.fill(FUNCTION, "x*y")
        expect(fault).to_be_empty()
        assert page.locator(FUNCTION).get_attribute("aria-invalid") is None
    page.fill(FUNCTION, "1/2x")
    expect(fault.first).to_contain_text("two ways")


def test_an_unknown_name_becomes_a_parameter_with_a_slider(page: Page) -> None:
    page.wait_for_selector(QUICK)
    specs = specs_of(page)
    page.fill(FUNCTION, "tanh(k*(x - y)) + t")
    page.get_by_role("button", name="Add k as a parameter").click()
    slider = page.get_by_role("slider", name="k", exact=True)
    expect(slider).to_be_visible()
    expect(page.locator("#panel-function .fault")).to_be_empty()
    before = slider.input_value()
    slider.focus()
    page.keyboard.press("ArrowRight")
    page.get_by_role("slider", name="t", exact=True).fill("0.5")
    page.wait_for_function("() => location.hash.includes('0.5')")
    for _ in range(600):  # the address follows sooner than the request
        if "t" in specs[-1]["monitor"]["u"]:
            break
        page.wait_for_timeout(100)
    source = specs[-1]["monitor"]["u"]
    assert source["parameters"]["k"] > float(before)
    assert source["t"] == 0.5
    # A name that leaves the expression takes its parameter along, and brings it back.
    number = page.get_by_role("spinbutton", name="value of k")
    number.fill("7")
    page.fill(FUNCTION, "tanh(x)")
    expect(number).to_have_count(0)
    page.fill(FUNCTION, "tanh(k*x)")
    expect(number).to_have_value("7")


def test_a_damaged_link_leaves_a_page_that_works(visit: Callable[..., Page]) -> None:
    u = {"expression": "tanh(k*x) + t", "parameters": {"k": 9}}
    page = visit('/#view={"colour":"document","blend":"x"}&u=x')
    page.wait_for_selector(QUICK)
    sliders = {"k": {}, "t": {"min": 0, "max": 1, "count": 10**9}}
    panel_at(
        page, "time", {"monitor": {"kind": "arc_length", "u": u}, "grid": {"n_xi": 9, "n_eta": 9}}, sliders=sliders
    )
    has_mesh(page, 9, 9)
    u["parameters"] = {"k": "abc"}
    panel_at(page, "time", {"monitor": {"kind": "arc_length", "u": u}})
    expect(page.locator("#panel-function .fault")).not_to_be_empty()


def test_a_folded_mesh_is_not_called_the_adapted_one(page: Page) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5), indexing="ij")
    document = {"status": "failed", "certificate": {}, "quality": None, "sentences": []}
    body = pack(document, {"uniform_x": x, "uniform_y": y})
    page.wait_for_selector(QUICK)
    page.route("**/v1/previews", lambda route: route.fulfill(body=body, content_type="application/x-npz"))
    page.reload()  # without a mesh before it, which would stay
    has_mesh(page, 5, 5)
    captions = page.locator("#captions")
    expect(captions).to_contain_text("no mesh")
    expect(captions).not_to_contain_text("adapted")
    expect(page.locator("#status")).to_contain_text("No mesh")


@pytest.mark.everything
def test_a_quick_look_that_finds_no_worker_does_not_come_after_the_mesh(visit: Callable[..., Page]) -> None:
    page = visit(f"/#spec={least_error_spec('h1')}")
    page.wait_for_selector("#stage[data-quick=false]")
    specs = specs_of(page)

    def answer(route: Any) -> None:
        if "smoothing" in (route.request.post_data or ""):
            route.fulfill(status=503, json={"title": "Workers busy", "detail": "All workers are busy."})
        else:
            route.continue_()

    page.route("**/v1/previews", answer)
    before = page.get_attribute("#stage", "data-drawings")
    page.fill(FUNCTION, "tanh(15*(x-y**2))")
    expect(page.locator("#stage")).not_to_have_attribute("data-drawings", before or "")
    page.wait_for_timeout(1500)  # longer than the pause before another attempt
    assert [spec["monitor"]["kind"] for spec in specs] == ["arc_length", "least_error"]


def test_a_busy_service_is_asked_again(page: Page) -> None:
    page.wait_for_selector(QUICK)
    page.complaints.expected.append("status of 503")  # type: ignore[attr-defined]
    asked = []

    def answer(route: Any) -> None:
        asked.append(route)
        if len(asked) == 1:
            route.fulfill(status=503, json={"title": "Workers busy", "detail": "All workers are busy."})
        else:
            route.continue_()

    page.route("**/v1/previews", answer)
    before = page.get_attribute("#stage", "data-drawings")
    page.fill(FUNCTION, "tanh(3*x)")
    expect(page.locator("#status")).to_contain_text("tries again")
    expect(page.locator("#stage")).not_to_have_attribute("data-drawings", before or "")
    expect(page.locator("#status")).to_contain_text("Mesh of 17 × 17 points")
    assert len(asked) == 2
