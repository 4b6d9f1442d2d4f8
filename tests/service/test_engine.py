"""Pebble keeps the contract of the engine port."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from equimesh_service.opening import PRELOAD
from equimesh_service.pebble_engine import PebbleEngine
from service.check_engine import check_engine, expect_closed


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory and kills are Linux's")
def test_pebble_keeps_the_contract(tmp_path: Path) -> None:
    engine = PebbleEngine(2, memory_limit=128, preload=PRELOAD)
    assert engine.wait_until_ready(30.0)
    try:
        check_engine(engine, tmp_path, memory_limit=128)
    finally:
        engine.close()
    expect_closed(engine)


def broken() -> None:
    """A warm-up that fails."""
    raise RuntimeError("no")


def test_an_engine_whose_workers_cannot_start_is_not_ready() -> None:
    engine = PebbleEngine(1, preload=PRELOAD, warm_up=broken)
    try:
        assert not engine.wait_until_ready(1.5)
    finally:
        engine.close()


# Called by tests only, and by other kernels only.
ELSEWHERE = {"_absolute", "at_piece", "holds", "largest_ratio", "piece", "slopes_at_piece", "walk", "within"}
COMPILED = """
import importlib, pkgutil, equimesh
from equimesh_service.worker import warm_up
warm_up()
for found in pkgutil.iter_modules(equimesh.__path__):
    module = importlib.import_module(f"equimesh.{found.name}")
    for name, value in vars(module).items():
        if hasattr(value, "nopython_signatures") and not value.nopython_signatures:
            print(name)
"""


def test_the_warm_up_leaves_nothing_to_compile() -> None:
    done = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True, timeout=300, check=True)
    assert set(done.stdout.split()) <= ELSEWHERE
