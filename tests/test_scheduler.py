"""What a process of tests takes at a time."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from scheduler import LOOSE, SHARED, FileScheduling, unit_of

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


class Node:
    """Stands for a process of tests: notes the numbers of those that it is given."""

    shutting_down = False

    def __init__(self) -> None:
        self.given: list[int] = []
        self.gateway = SimpleNamespace(id="gw")

    def send_runtest_some(self, numbers: list[int]) -> None:
        self.given += numbers


def test_a_process_in_the_place_of_one_that_crashed_gets_tests_when_it_has_collected_them(
    pytestconfig: pytest.Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pytestconfig.option, "tx", ["2*popen"])
    scheduling = FileScheduling(pytestconfig)
    tests = [f"tests/test_{file}.py::test_{k}" for file in range(9) for k in range(3)]
    first, second, third, fourth = nodes = [Node() for _ in range(4)]

    def collect(*those: Any) -> None:
        for node in those:
            scheduling.add_node(node)
            scheduling.add_node_collection(node, tests)

    collect(first, second)
    scheduling.schedule()
    for crashed in (first, second):
        scheduling.remove_node(crashed)  # type: ignore[arg-type]
    scheduling.add_node(fourth)  # type: ignore[arg-type]
    collect(third)
    scheduling.schedule()
    assert third.given
    assert fourth.given == []
    scheduling.add_node_collection(fourth, tests)  # type: ignore[arg-type]
    scheduling.schedule()
    assert all(node.given for node in nodes)
