"""The order of the tests, and the option that runs whole products of cases, of which else a covering part is run."""

from __future__ import annotations

import subprocess
import sys

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Compile the kernels once, before several processes of tests, with services of theirs, all do so at once."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        subprocess.run(
            [sys.executable, "-c", "from equimesh_service.worker.solve import warm_up; warm_up()"], check=True
        )


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--everything", action="store_true", help="also run what is marked `everything`: whole products")


# Files whose tests wait more than they work: begun first, so that no single one is waited for at the end.
LONG = ("test_durability", "test_replicas", "test_deployment", "test_faults", "test_backup", "test_base_install")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not item.path.stem.startswith(LONG))
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
