"""Where machine code is kept: what others can have written is not read, and a killed process holds nobody up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from equimesh.numerics import machine_code
from equimesh.numerics.machine_code import (
    Archive,
    DamagedError,
    Folder,
    Key,
    cache_path,
    find_archive,
    find_folder,
    opened,
    sealed,
    write_archive,
)
from equimesh.numerics.processor import tag

NAME = Key("package.loop", "ab" * 32, "(float64,)").name


@pytest.fixture(autouse=True)
def _own_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(machine_code, "ARCHIVES", tmp_path / "archives")
    monkeypatch.setenv("EQUIMESH_CACHE_DIR", str(tmp_path / "cache"))
    find_archive.cache_clear(), find_folder.cache_clear()
    yield
    find_archive.cache_clear(), find_folder.cache_clear()


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    (tmp_path / "kept").mkdir(mode=0o700)
    return Folder(tmp_path / "kept")


def test_an_entry_that_was_changed_or_cut_off_is_damaged() -> None:
    entry = sealed(b"content")
    assert opened(entry) == b"content"
    for wrong in (entry[:-1], entry + b"x", b"", b"X" + entry[1:], entry.replace(b"content", b"consent")):
        with pytest.raises(DamagedError):
            opened(wrong)


def test_a_folder_is_made_for_its_user_alone() -> None:
    folder = find_folder()
    assert isinstance(folder, Folder)
    folder.write(NAME, b"entry")
    modes = [os.stat(path).st_mode & 0o777 for path in (folder.path.parent, folder.path, folder.path / NAME)]
    assert modes == [0o700, 0o700, 0o600]
    assert (folder.read(NAME), folder.read("another")) == (b"entry", None)
    assert folder.stems() == {"package.loop-abababababababab-"}


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="there are no owners of this kind")
@pytest.mark.parametrize("part", [".", tag()])
@pytest.mark.parametrize("fault", ["group", "others", "owner"])
def test_a_folder_that_others_can_write_is_not_used(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, part: str, fault: str
) -> None:
    assert isinstance(find_folder(), Folder)
    if fault == "owner":
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    else:
        (cache_path() / part).chmod(0o770 if fault == "group" else 0o702)
    find_folder.cache_clear()
    found = find_folder()
    assert isinstance(found, str)
    assert "does not belong to this user alone" in found
    assert found in caplog.text


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="there are no owners of this kind")
@pytest.mark.parametrize("fault", ["writable", "owner", "link"])
def test_an_entry_that_others_can_have_written_is_not_read(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    folder.write(NAME, b"entry")
    assert folder.read(NAME) == b"entry"
    if fault == "writable":
        (folder.path / NAME).chmod(0o620)
    elif fault == "owner":
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    else:
        (folder.path / NAME).rename(folder.path / "elsewhere")
        (folder.path / NAME).symlink_to("elsewhere")
    assert folder.read(NAME) is None


def test_where_the_folder_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("EQUIMESH_CACHE_DIR", str(tmp_path))
    assert cache_path() == tmp_path
    monkeypatch.delenv("EQUIMESH_CACHE_DIR")
    if sys.platform == "linux":
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert cache_path() == tmp_path / "equimesh"
        monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # is to be ignored, says the specification
        assert cache_path() == tmp_path / "home" / ".cache" / "equimesh"


def test_the_oldest_stamps_of_a_loop_are_forgotten(folder: Folder) -> None:
    for number in range(12):
        for types in ("a", "b"):
            name = Key("package.loop", f"{number:064d}"[::-1], types).name
            folder.write(name, b"")
            if (folder.path / name).exists():
                os.utime(folder.path / name, (number, number))
    folder.write(Key("package.loop_of_another_name", "c" * 64, "a").name, b"")
    assert len(folder.stems()) == 9
    assert len(folder.names()) == 17


def test_an_archive_has_what_was_written(tmp_path: Path) -> None:
    entries = {Key("a", "1" * 64, "x").name: b"one", Key("b", "2" * 64, "x").name: b"second"}
    assert write_archive(tmp_path / "new" / "a.loops", entries.items()) == 2
    archive = Archive(tmp_path / "new" / "a.loops")
    assert archive.tag == tag()
    assert {name: archive.read(name) for name in entries} == entries
    assert archive.read("c") is None
    assert archive.stems() == {f"a-{'1' * 16}-", f"b-{'2' * 16}-"}


@pytest.mark.parametrize("fault", ["none", "empty", "changed", "cut", "level", "missing"])
def test_why_an_archive_is_not_used(fault: str) -> None:
    path = machine_code.archive_path()
    write_archive(path, [(NAME, b"entry")])
    data = path.read_bytes()
    if fault == "empty":
        path.write_bytes(b"")
    elif fault == "changed":
        path.write_bytes(data.replace(b"package", b"peckage"))
    elif fault == "cut":
        path.write_bytes(data[:70])
    elif fault == "level":
        path.rename(path.with_name("cpython-311-of-another-level.loops"))
    elif fault == "missing":
        path.unlink()
    found = find_archive()
    if fault == "none":
        assert isinstance(found, Archive)
        return
    assert isinstance(found, str)
    expected = {"level": "are for cpython-311-of-another-level, and this is", "missing": "came without an archive"}
    assert expected.get(fault, "is damaged") in found


def test_an_archive_under_the_name_of_another_level_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    path = machine_code.archive_path()
    with monkeypatch.context() as patch:
        patch.setattr(machine_code, "tag", lambda: "another")
        write_archive(path, [(NAME, b"entry")])
    found = find_archive()
    assert isinstance(found, str)
    assert f"is for another, and this is {tag()}" in found


@pytest.mark.skipif(sys.platform == "win32", reason="there are no locks of this kind")
class TestTurns:
    """One process makes an entry, and the others wait."""

    def test_the_second_one_waits(self, folder: Folder) -> None:
        order, holds, goes_on = list[str](), threading.Event(), threading.Event()

        def first() -> None:
            with folder.turn(NAME):
                holds.set()
                assert goes_on.wait(60.0)
                order.append("first")

        def second() -> None:
            with folder.turn(NAME):
                order.append("second")

        threads = [threading.Thread(target=each) for each in (first, second)]
        threads[0].start()
        assert holds.wait(60.0)
        threads[1].start()
        with folder.turn("another"):
            pass  # other entries are not held up
        threads[1].join(0.2)
        assert order == []
        goes_on.set()
        for thread in threads:
            thread.join(60.0)
        assert order == ["first", "second"]
        assert os.listdir(folder.path) == []

    def test_a_killed_process_holds_nobody_up_nor_do_its_children(self, folder: Folder) -> None:
        code = (
            "import os, pathlib, sys, time\n"
            "from equimesh.numerics.machine_code import Folder\n"
            "with Folder(pathlib.Path(sys.argv[1])).turn(sys.argv[2]):\n"
            "    child = os.fork()\n"
            "    if child: print(child, flush=True)\n"
            "    time.sleep(300)\n"
        )
        command = [sys.executable, "-c", code, str(folder.path), NAME]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
            child = int(holder.stdout.readline())
            holder.kill()
            holder.wait()
            try:
                with folder.turn(NAME):
                    assert os.path.exists(folder.path / f".{NAME}.lock")
            finally:
                os.kill(child, signal.SIGKILL)

    def test_who_waits_for_too_long_does_it_as_well(
        self, folder: Folder, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        monkeypatch.setattr(machine_code, "_TURN_SECONDS", 0.1)
        with folder.turn(NAME), folder.turn(NAME):
            assert "this one compiles the loop, too" in caplog.text

    def test_without_locks_each_does_it_for_itself(self, folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(machine_code, "fcntl", None)
        with folder.turn(NAME), folder.turn(NAME):
            assert os.listdir(folder.path) == []
