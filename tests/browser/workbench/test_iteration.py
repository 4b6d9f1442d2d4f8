"""The panel of the Schwarz iteration: player, outlines, curve, and the meshes between two iterates."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

import equimesh as em
from browser.workbench.states import panel_at, state
from equimesh.schwarz.decomposition import Ordering, turns

pytestmark = pytest.mark.needs("chromium")
ITERATIONS = 4
SPEC: dict[str, Any] = {
    "monitor": {"kind": "arc_length", "u": {"expression": "tanh(9*(x - y))"}},
    "grid": {"n_xi": 17, "n_eta": 13},
    "schwarz": {
        "subdomains": [2, 1],
        "ordering": "alternating",
        "transmission": {"kind": "classical"},
        "tolerance": None,
        "max_iterations": ITERATIONS,
    },
}
# Positions of a player of three steps, whose screen has a frame every 50 milliseconds.
PLAYED = """
async () => {
  const { createPlayer } = await import("./workbench/player.js");
  const { requestAnimationFrame } = window;
  let clock = 0;
  window.requestAnimationFrame = (show) => setTimeout(() => show((clock += 50)));
  const seen = [];
  const player = createPlayer({ name: "test", stepsPerSecond: 6, describe: String, onMove: (at) => seen.push(at) });
  player.setSteps(3, 0);
  player.element.querySelector("button").click();
  while (player.isPlaying) await new Promise((resolve) => setTimeout(resolve, 10));
  window.requestAnimationFrame = requestAnimationFrame;
  return seen;
}
"""


@pytest.fixture
def page(lasting_page: Page) -> Page:
    return lasting_page


def ready(page: Page, spec: dict[str, Any]) -> Locator:
    panel = panel_at(page, "iteration", spec)
    expect(panel.locator(".iteration-status")).to_have_text(re.compile(r"^Iteration \d+ of"), timeout=60_000)
    return panel


def outlined(page: Page) -> int:
    return page.locator("#overlay .outlines polygon.outline").count()


def test_each_subdomain_is_a_step_and_is_outlined(page: Page) -> None:
    panel = ready(page, SPEC)
    slider, status = panel.get_by_role("slider"), panel.locator(".iteration-status")
    expect(slider).to_have_attribute("max", str(2 * ITERATIONS))
    expect(status).to_have_text(f"Iteration {ITERATIONS} of {ITERATIONS}, subdomain 2 of 2.")
    assert outlined(page) == 0
    panel.get_by_role("button", name="One step back").click()
    expect(status).to_have_text(f"Iteration {ITERATIONS} of {ITERATIONS}, subdomain 1 of 2.")
    expect(page.locator("#overlay .outlines polygon.outline").first).to_be_attached()
    expect(slider).to_have_attribute("aria-valuetext", f"Iteration {ITERATIONS} of {ITERATIONS}, subdomain 1 of 2.")
    slider.press("Home")
    expect(status).to_have_text("The start of the iteration.")
    slider.press("ArrowRight")
    expect(status).to_have_text(f"Iteration 1 of {ITERATIONS}, subdomain 1 of 2.")
    slider.press("End")
    expect(page.locator("#overlay .outlines polygon")).to_have_count(0)


def test_the_iteration_plays_to_its_end_and_marks_the_iterate_on_the_curve(page: Page) -> None:
    panel = ready(page, SPEC)
    panel.get_by_role("combobox").select_option("1")
    panel.get_by_role("button", name="Play the iteration").click()
    expect(panel.get_by_role("button", name="Pause the iteration")).to_be_visible()
    expect(page.locator("#overlay .outlines polygon.outline").first).to_be_attached(timeout=30_000)
    panel.get_by_role("combobox").select_option("16")
    expect(panel.get_by_role("button", name="Play the iteration")).to_be_visible(timeout=30_000)
    expect(panel.get_by_role("slider")).to_have_value(str(2 * ITERATIONS))
    panel.get_by_role("slider").press("Home")
    panel.get_by_text("The curve as a table").click()
    rows = panel.locator("tbody tr")
    expect(rows).to_have_count(ITERATIONS + 1)
    expect(panel.locator("tbody tr[aria-current]")).to_have_text(re.compile(r"^0"))
    panel.get_by_role("slider").press("End")
    expect(panel.locator("tbody tr[aria-current]")).to_have_text(re.compile(rf"^{ITERATIONS}"))
    expect(panel.locator("svg.curve .curve-mark circle")).to_have_count(1)


def test_the_curve_says_the_observed_and_the_predicted_rate(page: Page) -> None:
    panel = ready(page, SPEC)
    picture = panel.locator("svg.curve")
    expect(picture).to_have_attribute("aria-label", re.compile(r"Observed rate 0\.\d+\. Predicted rate 0\.\d+\."))
    expect(picture.locator("line.curve-observed")).to_have_count(1)
    expect(picture.locator("line.curve-predicted")).to_have_count(1)
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(9*(x - y))")), grid=em.Grid(n_xi=17, n_eta=13))
    predicted = em.schwarz.predicted_rate(
        em.Schwarz(subdomains=(2, 1)).decompose(problem.grid),
        em.Schwarz(subdomains=(2, 1), ordering=Ordering.ALTERNATING, transmission=em.Classical()),
    )
    assert predicted is not None
    assert f"Predicted rate {predicted:#.2g}." in (picture.get_attribute("aria-label") or "")


def test_a_line_of_a_rate_begins_at_the_first_point_or_is_fitted_to_the_last_ones(page: Page) -> None:
    lines = page.evaluate("""
        async () => {
          const { lineOf } = await import("./workbench/curve.js");
          const points = [1, 2, 3, 4].map((iteration) => ({ iteration, value: 8 * 0.5 ** iteration }));
          return [lineOf(points, 0.5, true), lineOf(points, 0.25, false)];
        }
    """)
    assert lines[0] == [{"iteration": 1, "value": pytest.approx(4)}, {"iteration": 4, "value": pytest.approx(0.5)}]
    assert lines[1] == [{"iteration": 1, "value": pytest.approx(4)}, {"iteration": 4, "value": pytest.approx(4 / 64)}]


@pytest.mark.parametrize("ordering", list(Ordering))
def test_the_turns_are_those_of_the_solver(page: Page, ordering: Ordering) -> None:
    for subdomains in ((2, 1), (3, 1), (3, 2), (2, 3)):
        decomposition = em.Schwarz(subdomains=subdomains).decompose(em.Grid(n_xi=25, n_eta=25))
        windows = [
            {axis: [span.first, span.last] for axis, span in zip(("xi", "eta"), part.spans, strict=True)}
            for part in decomposition.parts
        ]
        found = page.evaluate(
            "([windows, ordering]) => import('./workbench/iterates.js').then((it) => it.turnsOf(windows, ordering))",
            [windows, str(ordering)],
        )
        assert found == turns(decomposition, ordering)


def test_nodes_move_with_their_subdomain(page: Page) -> None:
    """After the first of two subdomains its nodes are those of the next iterate, and all others those of the last."""
    found = page.evaluate("""
        async () => {
          const { mixed, stepsOf, turnsOf } = await import("./workbench/iterates.js");
          const subdomains = [{ xi: [0, 2], eta: [0, 0] }, { xi: [1, 3], eta: [0, 0] }];
          const steps = stepsOf(1, turnsOf(subdomains, "symmetric"), false);
          const at = (step, share) => [...mixed([0, 0, 0, 0], [1, 1, 1, 1], steps[step], subdomains, 1, share)];
          return [steps.map(({ active }) => active), at(1, 1), at(2, 0.5), at(3, 0.5), at(3, 1)];
        }
    """)
    assert found[0] == [[], [0], [1], [0]]
    assert found[1] == [0, 0, 0, 0]  # it is solved again, and moves then
    assert found[2] == [0, 0.5, 0.5, 0.5]
    assert found[3] == [0.5, 1, 1, 1]
    assert found[4] == [1, 1, 1, 1]


def test_little_motion_shows_whole_steps_only(page: Page) -> None:
    assert any(at != round(at) for at in page.evaluate(PLAYED))
    page.emulate_media(reduced_motion="reduce")
    still = page.evaluate(PLAYED)
    page.emulate_media(reduced_motion="no-preference")
    assert {*still} >= {0, 1, 2, 3}
    assert all(at == round(at) for at in still)


@pytest.mark.everything
def test_a_single_domain_has_no_iteration_and_can_be_split(page: Page) -> None:
    panel = panel_at(page, "iteration", {name: SPEC[name] for name in ("monitor", "grid")})
    expect(panel.get_by_text("There is no iteration to show")).to_be_visible()
    panel.get_by_role("button", name="Show one on 2 × 2 subdomains").click()
    status = panel.locator(".iteration-status")
    expect(status).to_have_text(re.compile(r"^Iteration \d+ of \d+\. The distance"), timeout=60_000)
    last = int((status.text_content() or "").split(" of ")[1].split(".")[0])
    legend = page.locator(".legend").text_content()
    panel.get_by_role("slider").press("End")
    expect(page.locator("#captions")).to_have_text("classical, convergedoptimized, converged")
    ends = re.compile(rf"^The optimized condition took \d iterations, the classical one {last}\.$")
    expect(page.locator("#headline")).to_have_text(ends)
    assert page.locator(".legend").text_content() == legend  # one scale for all iterates
    assert last > 20
    assert state(page)["spec"]["schwarz"]["subdomains"] == [2, 2]
    assert json.dumps(state(page)["spec"]["monitor"]) == json.dumps(SPEC["monitor"])
