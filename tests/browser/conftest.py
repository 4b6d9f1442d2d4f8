"""One service without keys, and one browser of each kind, for all pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi import Request, Response
from playwright.sync_api import Browser

from browser.browsers import BROWSERS
from equimesh_service import Settings, running
from equimesh_service.api import pages

FOLDER = Path(__file__).parent
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
    """The URL of the service, whose scripts a browser keeps: it would ask for each again with every page."""
    answer = pages._answer

    def kept(request: Request, file: pages.WorkbenchFile) -> Response:
        answered = answer(request, file)
        if file.media_type != "text/html":
            answered.headers["Cache-Control"] = "max-age=3600"
        return answered

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "_answer", kept)
        with running(page_settings) as url:
            yield url


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(nextitem: pytest.Item | None) -> Iterator[None]:
    """While Playwright is there, its event loop runs in this thread: tests of other folders run loops of theirs."""
    yield
    if nextitem is None or FOLDER not in nextitem.path.parents:
        BROWSERS.close()


@pytest.fixture(scope="module")
def chromium(request: pytest.FixtureRequest) -> Browser:
    """A browser; with WebGL where the module is marked so."""
    return BROWSERS.opened(WEBGL if request.node.get_closest_marker("webgl") else PLAIN)
