"""What a process of tests takes at a time."""

from __future__ import annotations

from pathlib import Path

import pytest

from scheduler import LOOSE, SHARED, unit_of

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("folder", SHARED)
def test_a_folder_that_shares_a_service_is_taken_in_few_parts(folder: str) -> None:
    files = [f"{path.relative_to(ROOT)}" for path in (ROOT / "tests" / folder).rglob("test_*.py")]
    units = {unit_of(f"{file}::test_a") for file in files}
    assert len(units) == min(SHARED[folder], len(files))
    assert {unit_of(f"{file}::TestB::test_c[d]") for file in files} == units


@pytest.mark.parametrize("file", LOOSE)
def test_tests_that_share_nothing_are_taken_one_by_one(file: str) -> None:
    assert (ROOT / file).is_file()
    assert unit_of(f"{file}::test_a") != unit_of(f"{file}::test_b")


def test_other_files_are_taken_whole() -> None:
    assert unit_of("tests/solver/plot/test_figure.py::TestA::test_b[c]") == "tests/solver/plot/test_figure.py"
