"""The warm-up with an archive, and the command that makes archives."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from equimesh import warm_up
from equimesh.numerics import machine_code, processor
from equimesh.numerics.compiled import Origin

# Makes an archive in the first process; in the second one prints where its loops came from.
CODE = """
import pathlib, sys
from collections import Counter
from equimesh.numerics import machine_code
from equimesh.numerics.compiled import count_compiled, count_kept, origins
from equimesh.warm_up import make_archive, warm_up
machine_code.ARCHIVES = pathlib.Path(sys.argv[2])
if sys.argv[1] == "make":
    make_archive()
else:
    assert count_compiled() == (count_kept().archive,) * 2
    warm_up()
    print(*Counter(origins.values()).keys(), len(origins))
    print(machine_code.find_folder())
"""


def run(*arguments: str, **variables: str) -> str:
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **single, **variables}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.everything  # two warm-ups; archives themselves are in tests/solver/numerics/test_machine_code.py
def test_with_an_archive_the_warm_up_compiles_nothing_and_needs_no_folder(tmp_path: Path) -> None:
    run("-c", CODE, "make", str(tmp_path / "archives"))
    (tmp_path / "a file").touch()  # no folder can be made there
    nowhere = str(tmp_path / "a file" / "folder")
    counted, folder = run("-c", CODE, "use", str(tmp_path / "archives"), EQUIMESH_CACHE_DIR=nowhere).splitlines()
    *kinds, number = counted.split()
    assert kinds == ["archive"]
    assert int(number) > 100
    assert "there is no folder" in folder


def test_where_an_archive_is_written_and_for_which_level(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(warm_up, "warm_up", lambda: None)
    monkeypatch.setattr(warm_up, "kept_entries", lambda: {"a-b-c": b"entry"})
    monkeypatch.setattr(warm_up, "origins", {})
    monkeypatch.setattr(machine_code, "ARCHIVES", tmp_path)
    monkeypatch.setattr(sys, "argv", ["warm_up", "--archive"])
    warm_up._main()
    assert machine_code.Archive(machine_code.archive_path()).read("a-b-c") == b"entry"
    assert "1 loops, 0.0 MB" in capsys.readouterr().out
    for name in ("CPU_NAME", "CPU_FEATURES"):
        monkeypatch.setattr(processor.config, name, getattr(processor.config, name))
    monkeypatch.setattr(sys, "argv", ["warm_up", "--archive", str(tmp_path / "b"), "--level", "x86-64-v2"])
    try:
        warm_up._main()
        assert machine_code.Archive(tmp_path / "b").tag.endswith("-x86-64-v2")
    finally:
        processor.level.cache_clear(), processor.tag.cache_clear()


@pytest.mark.parametrize("fault", ["used", "svml", "alone"])
def test_why_no_archive_is_made(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    monkeypatch.setattr(warm_up, "warm_up", lambda: pytest.fail("compiles"))
    monkeypatch.setattr(warm_up, "origins", {"a": Origin.COMPILED} if fault == "used" else {})
    monkeypatch.setattr(processor.config, "USING_SVML", fault == "svml")
    monkeypatch.setattr(sys, "argv", ["warm_up", *(["--archive"] if fault != "alone" else []), "--level", "x86-64-v2"])
    with pytest.raises(SystemExit) as ended:
        warm_up._main()
    said = f"{ended.value} {capsys.readouterr().err}"
    expected = {"used": "take a new one", "svml": "NUMBA_DISABLE_INTEL_SVML=1", "alone": "add --archive"}
    assert expected[fault] in said


def test_no_loop_makes_text() -> None:
    # For an assignment that could be broadcast Numba compiles the text of an error, which takes seconds.
    entries = warm_up.kept_entries()
    assert entries, "no loop is kept: python -m equimesh.warm_up"
    assert [name for name, entry in entries.items() if b"unicode" in entry] == []
