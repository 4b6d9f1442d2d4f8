"""One service without keys, and one browser of each kind, for all pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi import Request, Response
from playwright.sync_api import Browser

from browser.browsers import BROWSERS, PLAIN
from equimesh_service import Settings, running
from equimesh_service.api import pages

FOLDER = Path(__file__).parent


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
def chromium() -> Browser:
    """A browser without WebGL."""
    return BROWSERS.opened(PLAIN)
