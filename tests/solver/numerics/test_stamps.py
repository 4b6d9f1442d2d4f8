"""The stamp of a loop: it changes with what its machine code is made of, and with nothing else."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh.numerics.compiled import compiled
from equimesh.numerics.stamps import stamp_of

SOURCE = "def loop(x):\n    return x + CONSTANT\n"


def made(folder: Path, source: str = SOURCE, **values: Any) -> Callable[..., Any]:
    """The function of a file in a new folder, with these globals."""
    folder.mkdir()
    (folder / "file.py").write_text(source)
    spec = importlib.util.spec_from_file_location("file", folder / "file.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    vars(module).update(values)
    return module.loop  # type: ignore[no-any-return]


def test_equal_sources_have_equal_stamps_in_every_folder(tmp_path: Path) -> None:
    one, other = (stamp_of(made(tmp_path / name, CONSTANT=1.0)) for name in "ab")
    assert one == other
    assert stamp_of(made(tmp_path / "c", SOURCE + "# a line\n", CONSTANT=1.0)) != one


@pytest.mark.parametrize(
    ("first", "second"), [(1.0, 2.0), (1, 1.0), ((1, 2), (1, 3)), (np.zeros(2), np.ones(2)), (np.zeros(2), np.zeros(3))]
)
def test_the_constants_that_it_names_belong_to_it(tmp_path: Path, first: Any, second: Any) -> None:
    one, other = (stamp_of(made(tmp_path / str(k), CONSTANT=value)) for k, value in enumerate((first, second)))
    assert one != other


def test_so_do_the_loops_that_those_call_which_it_calls(tmp_path: Path) -> None:
    stamps = set()
    for number in range(2):
        inner = compiled(made(tmp_path / f"inner{number}", CONSTANT=number))
        middle = compiled(made(tmp_path / f"middle{number}", "def loop(x):\n    return INNER(x)\n", INNER=inner))
        stamps.add(stamp_of(made(tmp_path / f"outer{number}", "def loop(x):\n    return MIDDLE(x)\n", MIDDLE=middle)))
    assert len(stamps) == 2


def test_a_function_without_a_file_has_a_stamp() -> None:
    found = []
    for text in ("x + 1", "x + 2"):
        names: dict[str, Any] = {}
        exec(f"def loop(x):\n    return {text}\n", names)
        found.append(stamp_of(names["loop"]))
    assert found[0] != found[1]
