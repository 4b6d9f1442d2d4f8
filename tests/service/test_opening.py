"""The checks before a service opens."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from equimesh_service import Settings, service
from equimesh_service.engine.port import Health
from equimesh_service.errors import ClusterMissingError
from equimesh_service.service import check_cluster, pool_settings
from equimesh_service.worker import warmth
from equimesh_service.worker.job import Storage
from equimesh_service.worker.rare_loops import RareLoops


def test_a_cluster_without_dask_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with_cluster = Settings(engine="dask", scheduler="tcp://host:8786", data_dir=tmp_path)
    check_cluster(with_cluster)
    monkeypatch.setattr(service, "find_spec", lambda _: None)
    check_cluster(Settings(data_dir=tmp_path))
    with pytest.raises(ClusterMissingError, match=r"pip install 'equimesh\[dask\]'"):
        check_cluster(with_cluster)


def test_a_service_loads_none_of_the_packages_of_other_extras() -> None:
    others = ("dask", "distributed", "obstore", "opentelemetry.sdk", "psycopg", "sphinx", "zarr")
    code = f"import sys\nsys.modules.update(dict.fromkeys({others}))\nimport equimesh_service.server\n"
    # What is loaded when it starts is as little as it needs: the solver comes with the first check in the process.
    code += "assert not {'numba', 'scipy', 'h5py', 'meshio', 'matplotlib'} & sys.modules.keys()\n"
    code += f"import {', '.join(service.WARM_PRELOAD[:-1])}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_services_with_the_same_limits_share_the_pools_of_workers(tmp_path: Path) -> None:
    address = service.files_address(Settings(data_dir=tmp_path))
    (tmp_path / "files").mkdir()
    storage = Storage(f"sqlite:///{tmp_path / 'a.sqlite3'}", address)

    def name(**more: int) -> str:
        return pool_settings(Settings(engine="dask", scheduler="tcp://host:8786", **more), storage).name

    assert name() == name(workers=3)
    assert name() != name(memory_limit=100)


def test_workers_warm_up_unless_the_settings_say_otherwise(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    storage = Storage(f"sqlite:///{tmp_path / 'a.sqlite3'}", service.files_address(Settings(data_dir=tmp_path)))
    warm, cold = (pool_settings(Settings(warm_up=how), storage) for how in ("all", "none"))
    assert warm.warm_up is not None
    assert cold.warm_up is None
    assert set(warm.preload) - set(cold.preload) >= {"equimesh_service.worker.warm_fork"}


def test_workers_of_a_cluster_compile_all_loops_and_others_begin_with_the_basic_ones() -> None:
    ways = (Settings(warm_up="all"), Settings(warm_up="all", engine="dask", scheduler="tcp://host:8786"))
    assert [service._start_of_workers(way)[1] for way in ways] == [service.WARM_UP_BASICS, service.WARM_UP]
    assert all(
        callable(getattr(warmth, way.name.partition(":")[2])) for way in (service.WARM_UP_BASICS, service.WARM_UP)
    )


def test_a_service_that_is_ready_says_how_far_the_rest_is() -> None:
    count: Any = SimpleNamespace(latest=lambda: {"compiled": 53, "of": 153})
    loops = RareLoops(lambda: True, dict)
    ready, starting = (
        SimpleNamespace(health=lambda found=found: Health(ready=found, workers=2)) for found in (True, False)
    )
    engine: Any
    for engine, loops.are_compiling, is_told in ((starting, False, True), (ready, True, True), (ready, False, False)):
        assert (service._warm_up(Settings(), engine, loops, count) is not None) == is_told
