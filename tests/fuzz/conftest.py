"""A service of small limits for random requests, and the number and the seed of these."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from equimesh_service import Settings, running


def count_cases(few: int) -> int:
    """The number of cases to send: ``few`` in an ordinary run, ``FUZZ_CASES`` in a long one."""
    return int(os.environ.get("FUZZ_CASES", few))


def chosen_seed() -> int:
    """The seed of all cases: 1, or ``FUZZ_SEED``."""
    return int(os.environ.get("FUZZ_SEED", "1"))


@pytest.fixture(scope="session")
def fuzz_settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    """Small solves, short waits, and space for all requests."""
    return Settings(
        data_dir=tmp_path_factory.mktemp("fuzz"),
        port=0,
        workers=2,
        max_points=400,
        max_samples=1000,
        max_body=200_000,
        max_subdomains=8,
        max_iterations=5,
        max_queue=100_000,
        max_wait=0.5,
        time_limit=30.0,
        log_level="error",
    )


@pytest.fixture(scope="session")
def fuzz_url(fuzz_settings: Settings) -> Iterator[str]:
    """The URL of the service."""
    with running(fuzz_settings) as url:
        yield url


@pytest.fixture(scope="session")
def fuzz_http(fuzz_url: str) -> Iterator[httpx.Client]:
    """A plain HTTP client."""
    with httpx.Client(base_url=fuzz_url, timeout=600.0) as client:
        yield client


@pytest.fixture(scope="session")
def data_dir(fuzz_settings: Settings) -> Path:
    """The data folder of the service."""
    return fuzz_settings.data_dir
