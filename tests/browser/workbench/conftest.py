"""Pages of the workbench, which may not complain; each test has one that is as good as new."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from browser.browsers import BROWSERS, WEBGL

LAPTOP = {"width": 1366, "height": 768}
# The workbench with a small mesh that is solved in a moment.
SMALL = "/#u=tanh(20*(x-y))&n=17&monitor=arc_length"
# An answer of the same origin that runs no script.
BLANK = "/livez"
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
    pages: list[Page] = []

    def open_page(path: str = "/", **options: Any) -> Page:
        pages.append(new_page(chromium, **options))
        pages[-1].goto(url + path)
        return pages[-1]

    yield open_page
    for page in pages:
        page.context.close()
    check_complaints(*pages)


def new_page(chromium: Browser, **options: Any) -> Page:
    """A page of its own context, which lists its complaints; without motion, which costs a tenth of the processor."""
    context = chromium.new_context(**{"viewport": LAPTOP, "reduced_motion": "reduce", **options})
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    complaints = Complaints()
    page.complaints = complaints  # type: ignore[attr-defined]
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    return page


def check_complaints(*pages: Page) -> None:
    """None of these pages has complained, but as its test expected."""
    assert [each for page in pages for each in page.complaints.unexpected()] == []  # type: ignore[attr-defined]


def empty(page: Page, blank: str) -> None:
    """Make a page as good as a new one: nothing is stored, answered by a test, or below the pointer."""
    page.unroute_all(behavior="ignoreErrors")
    for other in page.context.pages:
        if other is not page:
            other.close()
    page.goto(blank)
    page.evaluate("() => { localStorage.clear(); sessionStorage.clear(); }")
    page.mouse.move(0, 0)
    page.complaints.clear()  # type: ignore[attr-defined]
    page.complaints.expected = []  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def one_page(chromium: Browser) -> Page:
    """A page that is emptied before each test: a new one costs twice as much."""
    return BROWSERS.page("one test", chromium, lambda: new_page(chromium))


@pytest.fixture
def visit(chromium: Browser, page_url: str, one_page: Page) -> Iterator[Callable[..., Page]]:
    """Opens pages of the workbench: ``visit("/#u=x", viewport=…)``; fails on errors in the console, and on CSP reports.

    Other keywords are those of a context of Playwright. ``page.complaints`` lists the errors so far.
    """
    empty(one_page, page_url + BLANK)
    is_free = True
    with visits(chromium, page_url) as open_page:

        def open_first(path: str = "/", **options: Any) -> Page:
            nonlocal is_free
            if options or not is_free:
                return open_page(path, **options)
            is_free = False
            one_page.goto(page_url + path)
            return one_page

        yield open_first
        check_complaints(one_page)


@pytest.fixture
def visit_webgl(page_url: str) -> Iterator[Callable[..., Page]]:
    """Opens pages as ``visit`` does, in a browser whose pages draw with WebGL2."""
    with visits(BROWSERS.opened(WEBGL), page_url) as open_page:
        yield open_page


@pytest.fixture(scope="module")
def lasting_page(chromium: Browser, page_url: str) -> Iterator[Page]:
    """One page for all tests of a module, each of which brings it to a state of its own."""
    page = BROWSERS.page("one module", chromium, lambda: new_page(chromium, reduced_motion="no-preference"))
    empty(page, page_url + BLANK)
    page.goto(page_url + SMALL)
    yield page
    check_complaints(page)


@pytest.fixture
def page(visit: Callable[..., Page]) -> Page:
    """The workbench with a small mesh that is solved in a moment."""
    return visit(SMALL)
