"""Pages of the workbench, which may not complain; each test has one of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

LAPTOP = {"width": 1366, "height": 768}
# The workbench with a small mesh that is solved in a moment.
SMALL = "/#u=tanh(20*(x-y))&n=17&monitor=arc_length"
# A browser reports every answer that is no success; wrong input is a 422, and the page shows it.
OF_WRONG_INPUT = "status of 422"
# All workers are busy: the page tries again.
OF_A_BUSY_SERVICE = "status of 503"
# A test is stopped after this many milliseconds without what it waits for, far more than a busy machine takes.
PATIENCE = 60_000


class Complaints(list[str]):
    """What a page wrote as errors to the console; a test lists those that it ``expected``, by a part of them."""

    def __init__(self) -> None:
        super().__init__()
        self.expected: list[str] = []

    def unexpected(self) -> list[str]:
        known = [OF_WRONG_INPUT, OF_A_BUSY_SERVICE, *self.expected]
        return [each for each in self if not any(part in each for part in known)]


expect.set_options(timeout=PATIENCE)


@contextmanager
def visits(chromium: Browser, url: str) -> Iterator[Callable[..., Page]]:
    """Opens pages, and closes them at the end; none of them may have complained then."""
    contexts: list[BrowserContext] = []
    all_complaints: list[Complaints] = []

    def open_page(path: str = "/", **options: Any) -> Page:
        context = chromium.new_context(**{"viewport": LAPTOP, **options})
        contexts.append(context)
        context.set_default_timeout(PATIENCE)
        page = context.new_page()
        complaints = Complaints()
        all_complaints.append(complaints)
        page.complaints = complaints  # type: ignore[attr-defined]
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(url + path)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [each for complaints in all_complaints for each in complaints.unexpected()] == []


@pytest.fixture
def visit(chromium: Browser, page_url: str) -> Iterator[Callable[..., Page]]:
    """Opens pages of the workbench: ``visit("/#u=x", viewport=…)``; fails on errors in the console, and on CSP reports.

    Other keywords are those of a context of Playwright. ``page.complaints`` lists the errors so far.
    """
    with visits(chromium, page_url) as open_page:
        yield open_page


@pytest.fixture(scope="module")
def lasting_page(chromium: Browser, page_url: str) -> Iterator[Page]:
    """One page for all tests of a module, each of which brings it to a state of its own."""
    with visits(chromium, page_url) as open_page:
        yield open_page(SMALL)


@pytest.fixture
def page(visit: Callable[..., Page]) -> Page:
    """The workbench with a small mesh that is solved in a moment."""
    return visit(SMALL)
