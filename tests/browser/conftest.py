"""One service without keys for all pages, and a browser for the tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, sync_playwright

from equimesh_service import Settings, running
from programs import browser as browser_program

# WebGL2 in software, for what is marked `webgl`: no test depends on the graphics of a machine.
WEBGL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# Neither WebGL nor a compositor that uses it: the workbench then draws with its other renderer. This is a third of the
# work of the processor.
PLAIN = ["--no-sandbox", "--disable-gpu"]


@pytest.fixture(scope="session")
def page_settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    folder = tmp_path_factory.mktemp("data")
    patience = 60.0  # seconds of a preview; a busy machine takes longer than the default
    return Settings(data_dir=folder, port=0, workers=1, log_level="warning", reuse=False, preview_seconds=patience)


@pytest.fixture(scope="session")
def page_url(page_settings: Settings) -> Iterator[str]:
    """The URL of the service."""
    with running(page_settings) as url:
        yield url


# While it is there, its event loop runs in this thread, and tests of other modules could run no loop of theirs.
@pytest.fixture(scope="module")
def chromium(request: pytest.FixtureRequest) -> Iterator[Browser]:
    flags = WEBGL if request.node.get_closest_marker("webgl") else PLAIN
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=browser_program(), args=flags)
        yield opened
        opened.close()
