"""One service without keys for all pages."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from equimesh_service import Settings, running


@pytest.fixture(scope="session")
def page_settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings(data_dir=tmp_path_factory.mktemp("data"), port=0, workers=1, log_level="warning", reuse=False)


@pytest.fixture(scope="session")
def page_url(page_settings: Settings) -> Iterator[str]:
    """The URL of the service."""
    with running(page_settings) as url:
        yield url
