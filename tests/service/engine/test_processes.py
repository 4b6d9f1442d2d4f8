"""Worker processes keep the contract of the engine port, with calls and outcomes as bytes."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from equimesh_service import Settings
from equimesh_service.engine import port
from equimesh_service.engine.port import PackedCall, Preparation, open_outcome, pack_error, pack_outcome
from equimesh_service.engine.processes import ProcessEngine
from equimesh_service.errors import MemoryLimitError
from equimesh_service.service import PRELOAD
from service.conftest import until
from service.engine.check_engine import add, allocate, check_engine, expect_closed, fail


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory and kills are Linux's")
def test_processes_keep_the_contract(tmp_path: Path) -> None:
    engine = ProcessEngine(2, memory_limit=128, preload=PRELOAD)
    assert engine.wait_until_ready(300.0)
    try:
        check_engine(engine, tmp_path, memory_limit=128)
    finally:
        engine.close()
    expect_closed(engine)


def broken() -> None:
    """A warm-up that fails."""
    raise RuntimeError("no")


def test_an_engine_whose_workers_cannot_start_is_not_ready() -> None:
    engine = ProcessEngine(1, preload=PRELOAD, warm_up=broken)
    try:
        until(lambda: engine.health().fault)
        assert engine.health().fault == "the workers cannot warm up: RuntimeError: no"
        assert engine.health().detail == engine.health().fault
        assert not engine.health().ready
    finally:
        engine.close()


def dies() -> None:
    """A warm-up that the system ends, for instance as it lacks memory."""
    os._exit(9)


def test_an_engine_whose_workers_die_when_they_start_says_so() -> None:
    engine = ProcessEngine(1, preload=PRELOAD, warm_up=dies)
    try:
        until(lambda: engine.health().fault)
        assert "the workers die when they start" in engine.health().fault
    finally:
        engine.close()


# In a process of its own, since the engines of a process share the server.
SERVER_DIES = """
import os, queue, signal, time
from equimesh_service.engine.processes import ProcessEngine
from equimesh_service.errors import WorkerLostError

engine = ProcessEngine(1, preload=["equimesh_service.engine.processes"])
assert engine.wait_until_ready(300.0)
server, worker = engine.submit(os.getppid).result(300.0), engine.submit(os.getpid).result(300.0)
again = queue.Queue()  # the waiter of a future wakes before its callback is called
running = engine.submit(time.sleep, 60.0)
running.add_done_callback(lambda _: again.put(engine.submit(os.getpid)))
time.sleep(0.2)
os.kill(server, signal.SIGKILL)
began = time.monotonic()
while engine.health().ready:
    assert time.monotonic() - began < 300.0, "reports that it is ready"
    time.sleep(0.01)
assert isinstance(running.exception(300.0), WorkerLostError)
assert again.get(timeout=300.0).result(300.0) != worker  # not lost again, with the other workers of that server
assert engine.wait_until_ready(300.0)
assert engine.submit(os.getppid).result(300.0) != server
assert engine.submit(os.getenv, "OPENBLAS_NUM_THREADS").result(300.0) == "1"
try:
    state = open(f"/proc/{worker}/stat").read().rpartition(")")[2].split()[0]
except OSError:
    state = "gone"
assert state in ("Z", "gone"), "the worker continues, and no one knows of it"  # the system's init may reap it late
engine.close()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks at processes")
def test_the_server_of_the_workers_is_replaced_with_them() -> None:
    """If anything else starts it, its numbers of threads are different."""
    variables = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", SERVER_DIES]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_a_worker_that_has_reached_its_limit_of_memory_is_replaced() -> None:
    """What is left of its memory is in pieces, and the next task needs the whole."""
    engine = ProcessEngine(1, memory_limit=64, preload=PRELOAD)
    try:
        first = engine.submit(os.getpid).result(300.0)
        assert isinstance(engine.submit(allocate, 1000).exception(300.0), MemoryLimitError)
        assert engine.submit(os.getpid).result(300.0) != first
    finally:
        engine.close()


class Unsendable(Exception):
    """An exception that can be pickled and not be unpickled."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def unsendable() -> None:
    raise Unsendable("a", "b")


def out_of_memory() -> None:
    raise MemoryError


def test_results_and_exceptions_come_back() -> None:
    assert open_outcome(pack_outcome(PackedCall.of(add, 2, 3))) == 5
    with pytest.raises(ValueError, match="bad"):
        open_outcome(pack_outcome(PackedCall.of(fail, "bad")))
    with pytest.raises(RuntimeError, match="Unsendable: ab"):
        open_outcome(pack_outcome(PackedCall.of(unsendable)))
    with pytest.raises(RuntimeError, match="closed"):
        open_outcome(pack_error(RuntimeError("closed")))


def test_a_lack_of_memory_is_left_to_the_process() -> None:
    with pytest.raises(MemoryError):
        pack_outcome(PackedCall.of(out_of_memory))


def test_a_worker_gets_the_log_and_the_tracer_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[Any] = []
    monkeypatch.setattr(port.logs, "configure", lambda *given: done.append(given))
    monkeypatch.setattr(port, "open_tracer", lambda *given: given)
    monkeypatch.setattr(port.tracing, "use", done.append)
    settings = Settings(log_level="error", log_format="json", trace_endpoint="http://traces:4318")
    pickle.loads(pickle.dumps(Preparation.of(settings)))()
    assert done == [("error", "json"), ("http://traces:4318", "worker")]


def test_an_interrupt_does_not_end_the_server_of_forks_while_it_imports(tmp_path: Path) -> None:
    (tmp_path / "interrupting.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    code = """
import signal
from equimesh_service.engine.fork_server import forking_context
signal.signal(signal.SIGINT, signal.default_int_handler)
process = forking_context(["interrupting"]).Process(target=print, args=("forked",))
process.start()
process.join()
"""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "forked\n", "")
