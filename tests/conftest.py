"""The option that runs whole products of cases, of which only a covering part is run otherwise."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--everything", action="store_true", help="also run what is marked `everything`: whole products")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--everything"):
        return
    left_out = [item for item in items if item.get_closest_marker("everything")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("everything")]


@pytest.fixture
def everything(request: pytest.FixtureRequest) -> bool:
    """Whether whole products were asked for; for tests that go through a product by themselves."""
    return bool(request.config.getoption("--everything"))
