"""Browsers and pages that all modules of tests share: a start, and the first visit of a page, cost most of a test."""

from __future__ import annotations

from collections.abc import Callable

from playwright.sync_api import Browser, Page, Playwright, sync_playwright

from programs import browser as browser_program

# WebGL2 in software: no test depends on the graphics of a machine.
WEBGL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# Neither WebGL nor a compositor that uses it: the workbench then draws with its other renderer. This is a third of the
# work of the processor.
PLAIN = ["--no-sandbox", "--disable-gpu"]


class Browsers:
    """Playwright, a browser for each set of flags, and pages of these; all of them are started when first used."""

    def __init__(self) -> None:
        self._playwright: Playwright | None = None
        self._opened: dict[tuple[str, ...], Browser] = {}
        self._pages: dict[tuple[str, Browser], Page] = {}

    def opened(self, flags: list[str]) -> Browser:
        """The browser with these flags."""
        if self._playwright is None:
            self._playwright = sync_playwright().start()
        if tuple(flags) not in self._opened:
            launched = self._playwright.chromium.launch(executable_path=browser_program(), args=flags)
            self._opened[tuple(flags)] = launched
        return self._opened[tuple(flags)]

    def page(self, use: str, browser: Browser, make: Callable[[], Page]) -> Page:
        """The page of a browser for this use."""
        if (use, browser) not in self._pages:
            self._pages[use, browser] = make()
        return self._pages[use, browser]

    def close(self) -> None:
        """End all of it; the next use starts anew."""
        for page in self._pages.values():
            page.context.close()
        for browser in self._opened.values():
            browser.close()
        self._pages.clear()
        self._opened.clear()
        if self._playwright is not None:
            self._playwright.stop()
            self._playwright = None


BROWSERS = Browsers()
