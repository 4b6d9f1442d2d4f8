"""States of the workbench: panels at a state of the page, and the state that the address tells."""

from __future__ import annotations

import json
from typing import Any
from urllib.parse import quote

from playwright.sync_api import Locator, Page, expect


def panel_at(page: Page, name: str, spec: dict[str, Any], **more: Any) -> Locator:
    """The opened panel ``name`` at the state ``spec``; ``more`` are other parts of the address."""
    words = {"spec": spec, **more}
    page.evaluate("hash => { location.hash = hash }", "&".join(f"{k}={quote(json.dumps(v))}" for k, v in words.items()))
    return opened(page, name)


def opened(page: Page, name: str) -> Locator:
    """The panel ``name``, opened."""
    panel = page.locator(f"#panel-{name}")
    expect(panel).to_be_visible()
    panel.locator("details").first.evaluate("node => { node.open = true }")
    return panel


NOW = "() => import('./workbench/address.js').then(({ stateOf }) => stateOf(location.hash))"
# The address is written a moment after a change: waits until it stays as it is.
SETTLED = """
async () => {
  const { stateOf } = await import("./workbench/address.js");
  for (let hash = null; hash !== location.hash; ) {
    hash = location.hash;
    await new Promise((resolve) => setTimeout(resolve, 400));
  }
  return stateOf(location.hash);
}
"""


def state(page: Page) -> dict[str, Any]:
    """What the address tells of the state: the spec, the view and the sliders."""
    found: dict[str, Any] = page.evaluate(SETTLED)
    return found


def state_now(page: Page) -> dict[str, Any]:
    """The same, although a change may not have reached the address: for tests that look again and again."""
    found: dict[str, Any] = page.evaluate(NOW)
    return found


def has_mesh(page: Page, n_xi: int, n_eta: int) -> None:
    """Wait until the requested mesh of this size is drawn."""
    stage = page.locator(f"#stage[data-points='{n_xi} {n_eta}'][data-quick='false']")
    expect(stage).to_be_visible(timeout=60_000)
