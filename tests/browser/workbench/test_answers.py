"""What the page says while it has no answer: grey results, a service that is gone, remedies, links, undo."""

from __future__ import annotations

import json
import re
from typing import Any
from urllib.parse import quote

import pytest
from playwright.sync_api import Page, Route, expect

from browser.workbench.states import has_mesh, state

pytestmark = pytest.mark.needs("chromium")
FUNCTION = "#panel-function textarea"
NOTICE = "#notice"
PREVIEWS = "**/v1/previews"
SPEC: dict[str, Any] = {
    "monitor": {"kind": "arc_length", "u": {"expression": "tanh(20*(x-y))"}},
    "grid": {"n_xi": 17, "n_eta": 17},
}
# Changes the function, and tells what is grey before any answer can be here.
TYPED = """async (text) => {
  const field = document.querySelector("#panel-function textarea");
  field.value = text;
  field.dispatchEvent(new InputEvent("input", { bubbles: true }));
  await null;
  await null;
  return ["stage", "headline", "panel-numbers"].filter((id) => document.getElementById(id).classList.contains("stale"));
}"""
# Types text, and tells whether it was called wrong when its answer came, and whether it is in the end. The clock stands
# still, so that an answer comes in no time, however busy the machine is.
TYPED_WRONG = """async (text) => {
  const field = document.querySelector("#panel-function textarea");
  const isWrong = () => field.getAttribute("aria-invalid") === "true";
  const { fetch } = window;
  const stopped = performance.now();
  performance.now = () => stopped;
  field.focus();
  field.value = text;
  const early = new Promise((tell) => {
    window.fetch = async (...all) => {
      const reply = await fetch(...all);
      if (reply.status === 422) reply.clone().text().then(() => setTimeout(() => tell(isWrong()), 300));
      return reply;
    };
  });
  field.dispatchEvent(new InputEvent("input", { bubbles: true }));
  const first = await early;
  window.fetch = fetch;
  delete performance.now;
  while (!isWrong()) await new Promise((resolve) => setTimeout(resolve, 20));
  return first;
}"""


@pytest.fixture
def page(lasting_page: Page) -> Page:
    """The page at `SPEC`, with its mesh."""
    lasting_page.unroute_all()  # what a test that failed has left
    show(lasting_page, SPEC)
    return lasting_page


def show(page: Page, spec: dict[str, Any]) -> None:
    """Give the page a description, and wait for its mesh."""
    page.evaluate("hash => { location.hash = hash }", f"spec={quote(json.dumps(spec))}")
    has_mesh(page, 17, 17)
    expect(page.locator("#headline")).not_to_have_class(re.compile("stale"))


def ran(page: Page, module: str, code: str, *values: Any) -> Any:
    """The value of an expression with the names of a module of the page, and `values`."""
    wrapped = f"async (values) => {{ const it = await import('./workbench/{module}'); return ({code}); }}"
    return page.evaluate(wrapped, list(values))


def test_an_answer_to_another_question_is_grey_at_once(page: Page) -> None:
    show(page, SPEC | {"monitor": SPEC["monitor"] | {"kind": "curvature"}})  # the page makes no first look of it
    held: list[Route] = []
    page.route(PREVIEWS, lambda route: held.append(route))
    assert page.evaluate(TYPED, "tanh(7*x)") == ["stage", "headline", "panel-numbers"]
    wait_for_one(page, held)
    held[0].continue_()
    page.unroute(PREVIEWS)
    expect(page.locator("#headline")).not_to_have_class(re.compile("stale"))
    expect(page.locator("#stage")).not_to_have_class(re.compile("stale"))


def test_a_mesh_is_grey_beside_a_fault_though_it_came_after_what_was_typed(page: Page) -> None:
    show(page, SPEC | {"monitor": SPEC["monitor"] | {"kind": "curvature"}})
    page.evaluate("() => { const now = performance.now(); performance.now = () => now; }")  # no request counts as late
    held: list[Route] = []
    page.route(PREVIEWS, lambda route: route.continue_() if held else held.append(route))
    page.fill(FUNCTION, "tanh(7*x)")
    wait_for_one(page, held)
    page.fill(FUNCTION, "1/0 + x")
    held[0].continue_()  # the mesh of the older text
    expect(page.locator("#panel-function .fault")).to_contain_text("not finite")
    page.evaluate("() => { delete performance.now; }")
    page.unroute(PREVIEWS)
    expect(page.locator("#stage")).to_have_class(re.compile("stale"))


def test_the_page_comes_back_after_the_service(page: Page) -> None:
    page.complaints.expected.append("net::ERR")  # type: ignore[attr-defined]
    page.route(PREVIEWS, lambda route: route.abort())
    page.fill(FUNCTION, "tanh(8*x)")
    expect(page.locator(NOTICE)).to_contain_text("The service does not answer")
    expect(page.locator("#headline")).to_contain_text("A first look that this page computes itself.")
    page.unroute(PREVIEWS)
    expect(page.locator("#headline")).not_to_contain_text("first look")
    expect(page.locator(NOTICE)).to_be_hidden()


def test_an_answer_to_an_older_change_does_not_end_the_first_look_of_a_newer_one(page: Page) -> None:
    has_mesh(page, 17, 17)
    page.complaints.expected.append("net::ERR")  # type: ignore[attr-defined]
    held: list[Route] = []
    page.route(PREVIEWS, lambda route: route.abort() if held else held.append(route))
    page.fill(FUNCTION, "tanh(7*x)")
    wait_for_one(page, held)
    page.fill(FUNCTION, "tanh(8*x)")
    held[0].continue_()  # the answer to the older one
    expect(page.locator(NOTICE)).to_contain_text("The service does not answer")
    expect(page.locator("#headline")).to_contain_text("A first look that this page computes itself.")


def wait_for_one(page: Page, held: list[Route]) -> None:
    """Return when a request is held."""
    while not held:
        page.wait_for_timeout(20)


def test_a_service_that_compiles_says_how_far_it_is(page: Page) -> None:
    busy = {"type": "/problems/workers-busy", "title": "Workers busy", "detail": "All workers are busy."}
    page.route(PREVIEWS, lambda route: route.fulfill(status=503, json=busy))
    unready = {"status": "unavailable", "warm_up": {"compiled": 37, "of": 146}}
    page.route("**/readyz", lambda route: route.fulfill(status=503, json=unready))
    page.fill(FUNCTION, "tanh(9*x)")
    expect(page.locator(NOTICE)).to_contain_text("compiles its loops, once in an environment. 37 of 146 are done")
    assert page.locator(f"{NOTICE} progress").evaluate("bar => [bar.value, bar.max]") == [37, 146]
    page.unroute(PREVIEWS)
    page.unroute("**/readyz")
    expect(page.locator(NOTICE)).to_be_hidden()


def test_a_service_that_is_ready_does_not_warm_up(page: Page) -> None:
    """It may still compile loops of rare kinds; that its workers are busy has then another reason."""
    for status, says in (("unavailable", True), ("ok", False)):
        readiness = {"status": status, "warm_up": {"compiled": 58, "of": 153}}
        said = ran(page, "notice.js", "it.waitingOf(...values)", {"status": 503}, readiness)
        assert (said is not None) == says


def test_a_failed_solve_keeps_the_last_mesh_and_a_button_does_what_its_remedy_says(page: Page) -> None:
    late = {
        "type": "/problems/time-limit",
        "status": 409,
        "title": "Time limit reached",
        "detail": "A preview is short.",
    }
    page.complaints.expected.append("status of 409")  # type: ignore[attr-defined]
    page.route(PREVIEWS, lambda route: route.fulfill(status=409, json=late))
    page.fill(FUNCTION, "tanh(10*x)")
    notice = page.locator(NOTICE)
    expect(notice).to_contain_text("than a preview may")
    assert page.get_attribute("#stage", "data-points") == "17 17"
    expect(page.locator("#panel-function .fault")).to_be_empty()
    expect(notice.get_by_role("button", name="Take 17 × 17 points")).to_have_count(0)  # it has no more
    notice.get_by_role("button", name="Compute it to its end").click()
    has_mesh(page, 17, 17)
    expect(notice).to_be_hidden()
    page.unroute(PREVIEWS)


def test_remedies_of_problems(page: Page) -> None:
    def remedies(problem: dict[str, Any], **spec: Any) -> list[dict[str, Any]]:
        found = ran(page, "remedies.js", "it.remediesOf(...values)", problem, {**SPEC, **spec})
        return [
            {"text": one["text"], **{k: v for k, v in one.get("spec", {}).items() if k != "monitor"}} for one in found
        ]

    large = {"grid": {"n_xi": 400, "n_eta": 20}}
    fewer = {"text": "Take 200 × 17 points", "grid": {"n_xi": 200, "n_eta": 17}}
    assert remedies({"type": "/problems/time-limit"}, **large)[1:] == [fewer]
    assert remedies({"type": "/problems/folded"}, monitor={"u": "x"}, **large) == [fewer]
    wrong = {"errors": [{"pointer": "/grid/n_xi", "message": "n_xi = -5"}]}
    assert remedies(wrong) == [{"text": "Take 33 × 33 points", "grid": {"n_xi": 33, "n_eta": 33}}]
    few = remedies(wrong, grid={"points": 30}, domain={"kind": "blocks"})
    assert [(one["text"], "grid" in one) for one in few] == [("Take the cells of the blocks", False)]
    classical = {"subdomains": [2, 2], "transmission": {"kind": "classical"}}
    assert [one["schwarz"] for one in remedies({"type": "/problems/not-converged"}, schwarz=classical)] == [
        {"subdomains": [2, 2]},
        {**classical, "max_iterations": 300},
    ]
    assert remedies({"type": "/problems/internal-error"}) == []


@pytest.mark.parametrize(
    ("hash", "words"),
    [
        ("spec=%7Bbroken", "The spec of this link is damaged"),
        ("garbage", "This link says nothing that the page can read"),
        pytest.param(
            'spec={"monitor":{"kind":"nothing","u":"x"}}', "the key 'kind' must be one of", marks=pytest.mark.everything
        ),
    ],
)
def test_a_broken_link_says_so(page: Page, hash: str, words: str) -> None:
    page.evaluate("hash => { location.hash = hash }", hash)
    expect(page.locator(NOTICE)).to_contain_text(words)
    expect(page.locator(NOTICE).get_by_role("button")).to_have_count(1)


def test_back_undoes_a_formula_and_a_choice_of_the_gallery(page: Page) -> None:
    page.fill(FUNCTION, "tanh(11*x)")
    assert state(page)["spec"]["monitor"]["u"] == {"expression": "tanh(11*x)"}
    page.route(PREVIEWS, lambda _: None)  # the mesh of the ring is not waited for
    page.get_by_role("button", name="Ring", exact=True).click()
    expect(page.locator(FUNCTION)).to_have_value(re.compile("0.09"))
    assert "0.09" in state(page)["spec"]["monitor"]["u"]["expression"]
    page.go_back()
    expect(page.locator(FUNCTION)).to_have_value("tanh(11*x)")
    page.go_back()
    expect(page.locator(FUNCTION)).to_have_value("tanh(20*(x-y))")
    page.unroute(PREVIEWS)
    page.go_forward()
    expect(page.locator(FUNCTION)).to_have_value("tanh(11*x)")
    has_mesh(page, 17, 17)


def test_nothing_moves_while_one_types_a_fault(page: Page) -> None:
    def places() -> list[Any]:
        return [page.locator(one).bounding_box() for one in ("#stage", "#headline", ".gallery")]

    has_mesh(page, 17, 17)  # until then the page still fills
    before = places()
    page.fill(FUNCTION, "sin(x*")
    expect(page.locator("#panel-function .fault")).to_contain_text("something is missing")
    assert places() == before
    order = page.eval_on_selector_all("aside section", "all => all.map((each) => each.id)")
    assert order.index("panel-gallery") < order.index("panel-numbers")  # which has more and fewer lines


def test_a_word_that_is_being_typed_is_not_called_wrong(page: Page) -> None:
    assert page.evaluate(TYPED_WRONG, "tanh(7*x) + si") is False


def test_a_formula_in_another_spelling_is_shown_as_it_was_understood(page: Page) -> None:
    page.locator(FUNCTION).fill("tanh(9x)^2")
    expect(page.locator("#panel-function .understood")).to_have_text("understood as tanh(9*x)**2")
    page.locator(FUNCTION).fill("tanh(9*x)")
    expect(page.locator("#panel-function .understood")).to_be_empty()


@pytest.mark.everything
def test_names_are_completed(page: Page) -> None:
    page.fill(FUNCTION, "")
    page.locator(FUNCTION).press_sequentially("3*sq")
    page.get_by_role("option", name="sqrt").click()
    expect(page.locator(FUNCTION)).to_have_value("3*sqrt(")
    page.locator(FUNCTION).press_sequentially("x) + ta")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(page.locator(FUNCTION)).to_have_value("3*sqrt(x) + tanh(")
    expect(page.get_by_role("listbox", name="Names that fit")).to_be_hidden()
    names = "it.completionsOf(...values).names"
    assert ran(page, "completion.js", names, "x + steepness", 8, ["steepness"]) == []  # inside a word
    assert ran(page, "completion.js", names, "x + st", 6, ["steepness"]) == ["steepness"]
    assert ran(page, "completion.js", names, "sin", 3) == []  # it is whole


def test_a_function_is_moved_to_another_domain(page: Page) -> None:
    fitted = "it.fitted(...values)"
    unit, wide = [[0, 1], [0, 1]], [[-1, 3], [0, 1]]
    assert ran(page, "fit.js", fitted, "exp(x) + 2x*max(y, ax)", unit, wide) == (
        "exp((0.25*x + 0.25)) + 2(0.25*x + 0.25)*max(y, ax)"
    )
    page.locator("#panel-domain details").first.evaluate("node => { node.open = true }")
    page.locator("#panel-domain").get_by_label("Kind").select_option("annulus_sector")
    page.locator(NOTICE).get_by_role("button", name="Fit it to this one").click()
    expect(page.locator(FUNCTION)).to_have_value("tanh(20*((0.5*x)-(0.5*y)))")
    expect(page.locator(NOTICE)).to_be_hidden()


def test_a_magnified_iterate_folds_no_cell(page: Page) -> None:
    square = [[0, 0, 1, 1], [0, 1, 0, 1]]
    assert ran(page, "race.js", "it.isFolded(...values)", square, [2, 2]) is False
    assert ran(page, "race.js", "it.isFolded(...values)", [[0, 0, 1, -1], [0, 1, 0, 1]], [2, 2]) is True
