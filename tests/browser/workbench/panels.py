"""What the tests of all panels do with a page: open a panel, read the spec, and look at the answer of the service."""

from __future__ import annotations

import json
from collections.abc import Callable
from time import monotonic
from typing import Any

from playwright.sync_api import Locator, Page, Response, expect

# Seconds, far more than a busy machine takes.
PATIENCE = 60
# Statuses after which the page tries again.
BUSY = (429, 503)
expect.set_options(timeout=1000 * PATIENCE)


def panel(page: Page, name: str) -> Locator:
    """The content of a panel, which is opened with everything inside it."""
    section = page.locator(f"#panel-{name}")
    section.wait_for(state="attached")
    section.evaluate("section => section.querySelectorAll('details').forEach((one) => { one.open = true; })")
    return section.locator(".content").first


def unfold(box: Locator) -> None:
    """Open what a change has put into a panel."""
    box.evaluate("box => box.querySelectorAll('details').forEach((one) => { one.open = true; })")


def spec_of(page: Page) -> dict[str, Any]:
    """The spec that the page would send now."""
    copy = panel(page, "copy")
    copy.get_by_label("Copy as").select_option("spec")
    found: dict[str, Any] = json.loads(copy.locator(".copy-text").text_content() or "")
    return found


def answered(page: Page, change: Callable[[], object]) -> Response:
    """The answer to the preview of the spec after a change; not that of its quick look, or of a busy service."""
    answers: list[Response] = []

    def keep(answer: Response) -> None:
        answers.append(answer)

    page.on("response", keep)
    change()
    wanted, begun = spec_of(page), monotonic()
    while monotonic() - begun < PATIENCE:
        for answer in [one for one in answers if "/v1/previews" in one.url]:
            if answer.status not in BUSY and answer.request.post_data_json == wanted:
                page.remove_listener("response", keep)
                return answer
        page.wait_for_timeout(25)
    raise AssertionError(f"no answer to {wanted}, but {[one.status for one in answers]}")


def set_number(box: Locator, label: str, value: float | str) -> None:
    """Type a number into a field, by its label."""
    box.get_by_label(label, exact=True).fill(str(value))


def fault_of(control: Locator) -> Locator:
    """The place under a control where its fault is told."""
    return control.locator("xpath=ancestor::*[contains(concat(' ', @class, ' '), ' field ')][1]").locator(".fault")
