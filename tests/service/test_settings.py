"""Settings load few modules, so that commands that only need them start quickly."""

from __future__ import annotations

import subprocess
import sys

import pytest

from equimesh.numerics.threads import available_cores
from equimesh_service import Settings


@pytest.mark.parametrize("module", ["equimesh_service.settings", "equimesh_service.errors"])
def test_neither_the_web_framework_nor_the_database_nor_the_solver_is_loaded(module: str) -> None:
    show = (
        f"import sys, {module}; print([n for n in ('fastapi', 'sqlalchemy', 'numba', 'equimesh') if n in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_a_single_worker_gets_all_cores_that_the_solver_counts() -> None:
    assert Settings(workers=1).worker_threads == min(64, available_cores())
