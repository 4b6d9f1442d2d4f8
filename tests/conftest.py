"""The order of the tests, what is left out where a program is missing, and the end of all that they start."""

from __future__ import annotations

import atexit
import faulthandler
import gc
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib.util import source_hash
from pathlib import Path
from typing import Any

import pytest

import leftovers
from programs import PROGRAMS, missing_program, must_be_here
from scheduler import LONG, SHARED, FileScheduling

# Before anything loads NumPy: threads of linear algebra spin while they wait, which costs some tests half their time,
# and several processes run at once. Services give their workers one thread, too.
for count in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(count, "1")
# All processes of a run keep what they compile, also where the environment says otherwise: there are hundreds.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

LEFT_OUT = pytest.StashKey[Counter[str]]()
MARK = pytest.StashKey[str]()
# Seconds from the last test until a process of tests must have ended, and until what it started is ended.
END_SECONDS, KILL_SECONDS = 300.0, 270.0


def pytest_configure(config: pytest.Config) -> None:
    """Mark what this run starts, and compile once what several processes would all compile.

    Services of tests start without a warm-up, which costs more than what most of them solve. They let requests wait
    longer than a mesh takes on a busy machine.
    """
    os.environ.setdefault("EQUIMESH_WARM_UP", "none")
    os.environ.setdefault("EQUIMESH_MAX_WAIT", "300")
    if not hasattr(config, "workerinput"):
        name = config.stash[MARK] = f"{os.getpid()} {time.time()}"
        leftovers.mark(name)
        # At the very end: as long as something that is left holds the output, whoever reads that waits.
        atexit.register(lambda: leftovers.report(leftovers.end_marked(name)))
        if config.getoption("numprocesses", None):
            _compile_once()


# Fails where a loop is not kept yet.
ALL_KEPT = """
import equimesh.warm_up
from equimesh.numerics.compiled import count_compiled

compiled, of = count_compiled()
raise SystemExit(compiled < of)
"""


def _compile_once() -> None:
    """Compile the kernels in two processes, which meet in the middle; the second one then collects tests.

    Pytest compiles what it collects. What is compiled already, as after a run before, is left out.
    """
    warm_up = [sys.executable, "-c", "from equimesh.warm_up import warm_up; warm_up()"]
    backwards = "from equimesh.warm_up import warm_up_rare; warm_up_rare(backwards=True)"
    tests = [str(path) for path in _not_compiled()]
    collect = (
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--collect-only", *tests] if tests else ["true"]
    )
    second = ["sh", "-c", '"$0" -c "$1"; shift; exec "$@"', sys.executable, backwards, *collect]
    if subprocess.run([sys.executable, "-c", ALL_KEPT]).returncode == 0:
        warm_up, second = ["true"], collect
    silent = subprocess.DEVNULL
    with subprocess.Popen(second, stdin=silent, stdout=silent, stderr=silent, start_new_session=True) as compiling:
        try:
            subprocess.run(warm_up, check=True)
            compiling.wait()
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(compiling.pid, signal.SIGKILL)
            raise


def _not_compiled() -> list[Path]:
    """The files of tests that pytest has not compiled as they are: it keeps the hash of a file, not its time."""
    folder, name = Path(__file__).parent, f"{sys.implementation.cache_tag}-pytest-{pytest.__version__}.pyc"
    kept = {path: path.parent / "__pycache__" / f"{path.stem}.{name}" for path in folder.rglob("test_*.py")}
    return [
        path for path, at in kept.items() if not at.exists() or at.read_bytes()[8:16] != source_hash(path.read_bytes())
    ]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> FileScheduling:
    """With `-n`, whole files go to a process, those with long waits first."""
    return FileScheduling(config, log)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--everything", action="store_true", help="also run what is marked `everything`: whole products")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    # First the folders of which a process takes many files at once, then files that take long.
    places = {folder: place for place, folder in enumerate(SHARED)}
    items.sort(key=lambda item: (places.get(item.nodeid.split("/")[1], 99), not item.path.stem.startswith(LONG)))
    if not config.getoption("--everything"):
        _leave_out(config, items, [item for item in items if item.get_closest_marker("everything")])
    missing = {item: name for item in items if (name := missing_program(item)) and not must_be_here(name)}
    config.stash[LEFT_OUT] = Counter(missing.values())
    _leave_out(config, items, [*missing])


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect tests without a search for garbage, which takes two fifths of the time, and never search among them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_finish() -> None:
    """Let httpx read the certificates of all authorities once, not for each request: 27 ms each, and tests poll."""
    if transports := sys.modules.get("httpx._transports.default"):
        vars(transports)["create_ssl_context"] = cache(vars(transports)["create_ssl_context"])


def _leave_out(config: pytest.Config, items: list[pytest.Item], left_out: list[pytest.Item]) -> None:
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        gone = {*left_out}
        items[:] = [item for item in items if item not in gone]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Fail where a program is missing that must be here."""
    name = missing_program(item)
    if name is not None:
        pytest.fail(f"{PROGRAMS[name].name} is not installed: {PROGRAMS[name].remedy}", pytrace=False)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Name a test that failed at once: a run that is cut off never reaches its summary."""
    if report.failed and "PYTEST_XDIST_WORKER" not in os.environ:
        print(f"\n{report.nodeid} failed ({report.when}):\n{report.longreprtext}", file=sys.__stderr__, flush=True)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Report to the process that started this one how many tests were left out: with `-n`, every process reports.

    A process that does not end afterwards says where it stands, and is ended, after all that it has started.
    """
    if name := session.config.stash.get(MARK, None):
        leftovers.end_later(KILL_SECONDS, lambda: leftovers.report(leftovers.end_marked(name)))
    faulthandler.dump_traceback_later(END_SECONDS, exit=True, file=sys.__stderr__)
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = dict(session.config.stash.get(LEFT_OUT, Counter()))


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take over what a process of tests left out."""
    if left_out := getattr(node, "workeroutput", {}).get("left_out"):
        node.config.stash[LEFT_OUT] = Counter(left_out)


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """One line for each missing program."""
    for name, number in sorted(config.stash.get(LEFT_OUT, Counter()).items()):
        program = PROGRAMS[name]
        tests = "1 test was" if number == 1 else f"{number} tests were"
        terminalreporter.write_line(f"{program.name} is not installed: {tests} left out; {program.remedy}")


@pytest.fixture
def everything(request: pytest.FixtureRequest) -> bool:
    """Whether whole products were asked for; for tests that go through a product by themselves."""
    return bool(request.config.getoption("--everything"))
