"""Settings load few modules, and the docstring of ``errors`` has the tree of exceptions."""

from __future__ import annotations

import pkgutil
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from pydantic import ValidationError

import equimesh_service
from equimesh.numerics.threads import available_cores
from equimesh_service import Settings, errors
from equimesh_service.settings import FILE_WORKERS, SERVICE_MIB, groups


def test_neither_the_web_framework_nor_the_database_nor_the_solver_is_loaded() -> None:
    show = "import sys, equimesh_service.settings, equimesh_service.errors\n"
    show += "print([n for n in ('fastapi', 'sqlalchemy', 'numba', 'equimesh') if n in sys.modules])"
    found = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_the_engine_dask_needs_a_scheduler_and_no_workers_here() -> None:
    with pytest.raises(ValidationError, match="the engine dask needs a scheduler: give its address"):
        Settings(engine="dask")
    settings = Settings(engine="dask", scheduler="tcp://host:8786", workers=8, memory_limit=100)
    assert (settings.worker_threads, settings.own_workers) == (1, 0)
    assert settings.most_memory == FILE_WORKERS * 100 + SERVICE_MIB


def test_a_single_worker_gets_all_cores_that_the_solver_counts() -> None:
    assert Settings(workers=1).worker_threads == min(64, available_cores())


def test_every_setting_is_in_one_group() -> None:
    found = groups()
    assert [name for names in found.values() for name in names] == list(Settings.model_fields)
    assert found["network"][:2] == ["host", "port"]
    assert "s3_secret_key" in found["storage"]
    assert all(name.startswith("key_") for name in found["keys and quotas"][1:])


def test_the_engine_of_earlier_releases_keeps_its_name(tmp_path: Path) -> None:
    assert Settings(data_dir=tmp_path, engine="pebble").engine == "processes"  # type: ignore[arg-type]


_OTHERS = ("equimesh_service.store.migrations",)  # alembic alone can import these


def existing() -> dict[str, str]:
    """Every exception class that a module of the service defines, and its base there."""
    found: dict[str, str] = {}
    for info in pkgutil.walk_packages(equimesh_service.__path__, "equimesh_service."):
        if info.name.startswith(_OTHERS):
            continue
        for thing in vars(import_module(info.name)).values():
            if isinstance(thing, type) and issubclass(thing, BaseException) and thing.__module__ == info.name:
                found[thing.__name__] = thing.__bases__[0].__name__
    return found


def drawn() -> dict[str, str]:
    """Every class of the drawing, and its base there."""
    found: dict[str, str] = {}
    above: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        entry = re.match(r"    ((?:[│ ]   )*)(?:[├└]── )?([A-Z]\w+)\b", line)
        if entry is None:
            continue
        depth = len(entry[1]) // 4 + ("── " in line)
        found[entry[2]] = above[depth - 1] if depth else "Exception"
        above[depth:] = [entry[2]]
    return found


def test_the_drawn_tree_is_the_tree_that_exists() -> None:
    assert drawn() == existing()
    assert drawn()["NewerDatabaseError"] == "UnusableDatabaseError"
