"""Loops as machine code: the same numbers, and compiled once for all processes and environments with equal sources."""

from __future__ import annotations

import importlib
import importlib.util
import math
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh.numerics import compiled as module
from equimesh.numerics import machine_code
from equimesh.numerics.compiled import Origin, compiled, count_compiled, count_kept, kept_entries, origins, vectorised
from equimesh.numerics.machine_code import find_archive, find_folder, stem

# Loops in files of their own: `outer` calls `inner` of another file, `alone` calls nothing.
FILES = {
    "inner.py": "from equimesh.numerics.compiled import compiled\n\n@compiled\ndef inner(x):\n    return x + 1.0\n",
    "outer.py": "from equimesh.numerics.compiled import compiled\nfrom FOLDER.inner import inner\n\n"
    "@compiled\ndef outer(x):\n    return 2.0 * inner(x)\n",
    "alone.py": "from equimesh.numerics.compiled import compiled\nFACTOR = 3.0\n\n"
    "@compiled\ndef alone(x):\n    return FACTOR * x\n",
}
COMPILED, FOLDER, ARCHIVE = Origin.COMPILED, Origin.FOLDER, Origin.ARCHIVE


def mean_square(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += value * value
    return total / len(values)


@pytest.fixture(autouse=True)
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A new folder for compiled loops, and no archive."""
    with look_anew():
        monkeypatch.setenv("EQUIMESH_CACHE_DIR", str(tmp_path / "kept"))
        monkeypatch.setattr(machine_code, "ARCHIVES", tmp_path / "archives")
        yield tmp_path / "kept"


@contextmanager
def look_anew() -> Iterator[None]:
    """Look for folder and archive inside, and once more afterwards."""
    find_archive.cache_clear(), find_folder.cache_clear()
    yield
    find_archive.cache_clear(), find_folder.cache_clear()


def use(folder: Path, monkeypatch: pytest.MonkeyPatch, **edits: str) -> dict[str, Origin]:
    """Where the loops came from, when they were imported from a new folder, as a new environment does, and called."""
    folder.mkdir(parents=True)
    for name, text in FILES.items():
        edited = text.replace("FOLDER", "loops_of_a_test")
        (folder / name).write_text(edited + edits.get(name.removesuffix(".py"), ""))
    before, results = dict(origins), list[float]()
    origins.clear()
    with monkeypatch.context() as patch:
        for name in ("loops_of_a_test", *(f"loops_of_a_test.{one.removesuffix('.py')}" for one in FILES)):
            file = folder / f"{name.partition('.')[2]}.py" if "." in name else None
            spec = (
                importlib.util.spec_from_file_location(name, file)
                if file
                else importlib.util.spec_from_loader(name, None)
            )
            module = importlib.util.module_from_spec(spec)
            patch.setitem(sys.modules, name, module)
            if spec.loader is not None:
                spec.loader.exec_module(module)
                results.append(getattr(module, name.rpartition(".")[2])(5.0))
    found = {key.loop.rpartition(".")[2]: origin for key, origin in origins.items()}
    origins.clear()
    origins.update(before)
    assert results == [6.0, 12.0, 15.0]
    return found


@pytest.mark.parametrize("make", [compiled, vectorised])
def test_compiled_loops_give_the_same_number(make: Callable[..., Any]) -> None:
    values = np.random.default_rng(1).random(1000)
    found = make(mean_square)(values)
    assert found == pytest.approx(mean_square(values), rel=1e-13)
    assert make(mean_square)(values) == found, "and the same one each time"


def test_without_reordering_sums_are_those_of_python() -> None:
    values = np.random.default_rng(2).random(1000) * 10.0 ** np.random.default_rng(3).integers(-8, 8, 1000)
    assert compiled(mean_square)(values) == mean_square(values)
    assert math.isnan(compiled(mean_square)(np.array([1.0, math.nan])))
    assert math.isnan(compiled(mean_square)(np.empty(0))), "0/0, without an exception"


def test_a_second_environment_with_equal_sources_compiles_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert use(tmp_path / "first", monkeypatch) == {"inner": COMPILED, "outer": COMPILED, "alone": COMPILED}
    assert use(tmp_path / "second", monkeypatch) == {"outer": FOLDER, "inner": FOLDER, "alone": FOLDER}


@pytest.mark.parametrize(("edited", "new"), [("inner", {"inner", "outer"}), ("outer", {"outer"}), ("alone", {"alone"})])
def test_after_an_edit_exactly_what_depends_on_it_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edited: str, new: set[str]
) -> None:
    use(tmp_path / "first", monkeypatch)
    found = use(tmp_path / "second", monkeypatch, **{edited: "\n# another line\n"})
    assert {name for name, origin in found.items() if origin == COMPILED} == new


def test_an_archive_is_used_before_the_folder(tmp_path: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use(tmp_path / "first", monkeypatch)
    folder = machine_code.find_folder()
    assert isinstance(folder, machine_code.Folder)
    entries = {name: folder.read(name) or b"" for name in folder.names()}
    machine_code.write_archive(machine_code.archive_path(), entries.items())
    shutil.rmtree(kept)
    with look_anew():
        found = use(tmp_path / "second", monkeypatch, alone="\n# changed since\n")
    assert found == {"outer": ARCHIVE, "inner": ARCHIVE, "alone": COMPILED}


def test_a_damaged_loop_is_compiled_anew_and_told(
    tmp_path: Path, kept: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    use(tmp_path / "first", monkeypatch)
    (file,) = kept.glob("*/*.alone-*")
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    found = use(tmp_path / "second", monkeypatch)
    assert found == {"outer": FOLDER, "inner": FOLDER, "alone": COMPILED}
    assert "alone in the folder is damaged; it is compiled anew" in caplog.text
    assert use(tmp_path / "third", monkeypatch)["alone"] == FOLDER


def test_an_entry_of_another_loop_is_not_used(tmp_path: Path, kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use(tmp_path / "first", monkeypatch)
    (inner,), (alone,) = kept.glob("*/*.inner-*"), kept.glob("*/*.alone-*")
    shutil.copy(inner, alone)
    assert use(tmp_path / "second", monkeypatch)["alone"] == COMPILED


@pytest.mark.parametrize("place", ["a file", "read-only"])
def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    (tmp_path / "a file").write_text("")
    if place == "read-only":  # the superuser may write everywhere
        monkeypatch.setattr(
            machine_code.tempfile, "mkstemp", lambda **_: (_ for _ in ()).throw(PermissionError(13, "no"))
        )
    monkeypatch.setenv("EQUIMESH_CACHE_DIR", str(tmp_path / place))
    assert set(use(tmp_path / "first", monkeypatch).values()) == {COMPILED}
    assert set(use(tmp_path / "second", monkeypatch).values()) == {COMPILED}


def refused(**_: Any) -> None:
    raise PermissionError(13, "Permission denied")


def test_loops_of_the_project_are_counted_where_they_are_kept() -> None:
    importlib.import_module("equimesh.sweeps.kernels")  # which has some
    kept = count_kept()
    assert sum(kept) == count_compiled().of > 0


# Eight processes need the same loops at the same time: prints how many times one was compiled.
EIGHT = """
import os, sys
from equimesh.numerics.compiled import Origin, origins
sys.path.insert(0, sys.argv[1])
from loops.outer import outer
children = []
for _ in range(8):
    if (child := os.fork()) == 0:
        assert outer(5.0) == 12.0
        os._exit(list(origins.values()).count(Origin.COMPILED))
    children.append(child)
print(sum(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there are no locks of this kind")
def test_of_eight_processes_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "loops").mkdir()
    for name, text in FILES.items():
        (tmp_path / "loops" / name).write_text(text.replace("FOLDER", "loops"))
    command = [sys.executable, "-c", EIGHT, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.stdout, done.stderr) == ("2\n", "")
    assert list((tmp_path / "kept").glob("*/.*")) == [], "no lock is left"


def test_what_is_kept_of_the_loops_and_of_those_inside_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_loops", loops := list[Any]())
    monkeypatch.setattr(module, "origins", dict[Any, Origin]())
    inner = module.compiled(mean_square)
    outer = module.compiled(lambda values: inner(values))
    loops += [inner, outer]
    outer(np.ones(3))
    assert len(kept_entries()) == 2
    assert {stem(name) for name in kept_entries()} == {loop._cache.key("").stem for loop in loops}
    loops.remove(inner)
    assert len(kept_entries()) == 1
    shutil.rmtree(tmp_path / "kept")
    with pytest.raises(RuntimeError, match="lambda_ is not kept"):
        kept_entries()
