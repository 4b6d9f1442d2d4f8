"""What a newcomer has to read: the files that one call visits, and the size of the tree, beside their goals.

A file counts as visited where one of its functions is called. Every call is made twice, and the second one counts: the
first also imports and compiles.

    python benchmarks/road.py                     a minute
    python benchmarks/road.py --files auto        also every file that `em.solve` of an `Auto` monitor visits
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ("solver", "service", "client")
U = "tanh(40*(y - 0.5 - 0.1*sin(2*pi*x)))"
PROFILE = "EQUIMESH_ROAD"  # the folder into which the processes of a service write what they visit


@dataclass(frozen=True, kw_only=True)
class Count:
    """One number with its goal; ``files`` are those that a road visits."""

    name: str
    what: str
    value: int
    goal: int
    files: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.what:58} {self.value:7,} {self.goal:7,}  {'met' if self.value <= self.goal else 'missed'}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print every count next to its goal."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", choices=("auto", "arc_length", "post"), help="list the files of this road, too")
    options = parser.parse_args(arguments)
    print(f"{'':58} {'is':>7} {'goal':>7}")
    for count in [*roads(), *sizes()]:
        print(count)
        if count.name == options.files:
            print(*(f"    {file}" for file in count.files), sep="\n")


def roads(*, posted: bool = True) -> Iterator[Count]:
    """The files of the project that three calls visit; without ``posted``, those of the two calls in Python."""
    import equimesh as em

    grid = em.Grid(n_xi=17, n_eta=17)
    u = em.Expression(U)
    for name, monitor, goal in (("auto", em.Auto(u=u), 45), ("arc_length", em.ArcLength(u=u), 30)):
        problem = em.Problem(monitor=monitor, grid=grid)
        em.solve(problem)
        with _visited() as files:
            em.solve(problem)
        yield _road(name, f"files that em.solve visits, {type(monitor).__name__}", goal, files)
    if posted:
        yield _road("post", "files of POST /v1/meshes?format=vtu, both processes", 110, _posted())


def _posted() -> set[str]:
    """The files that the second request for a mesh file visits, in the service and in its worker."""
    import httpx

    from equimesh_service import Settings, running

    with tempfile.TemporaryDirectory() as folder:
        os.environ[PROFILE] = folder
        path = os.environ.get("PYTHONPATH", "")
        # The processes of workers import `sitecustomize` when they start.
        (Path(folder) / "sitecustomize.py").write_text("import road\n\nroad.profile()\n")
        os.environ["PYTHONPATH"] = os.pathsep.join([folder, str(Path(__file__).parent), *filter(None, [path])])
        try:
            settings = Settings(data_dir=Path(folder) / "data", port=0, workers=1, log_level="warning", reuse=False)
            threading.setprofile(_writer(Path(folder)))
            with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
                for _ in range(2):
                    for written in Path(folder).glob("*.visited"):
                        written.unlink()
                    answer = http.post(
                        "/v1/meshes?format=vtu",
                        json={"monitor": {"u": U}, "grid": {"n_xi": 17, "n_eta": 17}},
                        headers={"Prefer": "wait=60"},
                    )
                    answer.raise_for_status()
                return {line for path in Path(folder).glob("*.visited") for line in path.read_text().splitlines()}
        finally:
            threading.setprofile(None)
            os.environ["PYTHONPATH"] = path
            del os.environ[PROFILE]


def profile() -> None:
    """Write the files of the project that this process visits into the folder of the measurement."""
    writer = _writer(Path(os.environ[PROFILE]))
    threading.setprofile(writer)
    sys.setprofile(writer)


def _writer(folder: Path) -> Callable[[FrameType, str, object], None]:
    known: dict[str, str | None] = {}
    written: dict[Path, set[str]] = {}

    def visit(frame: FrameType, event: str, _: object) -> None:
        if event != "call" or frame.f_code.co_name == "<module>":
            return
        code = frame.f_code.co_filename
        if code not in known:
            known[code] = _of_project(code)
        file = known[code]
        if file is None:
            return
        # A process writes into a file of its own, which is removed to begin anew.
        path = folder / f"{os.getpid()}-{threading.get_ident()}.visited"
        there = written.setdefault(path, set())
        if not os.path.exists(path):
            there.clear()
        if file not in there:
            there.add(file)
            with path.open("a") as out:
                out.write(f"{file}\n")

    return visit


@contextmanager
def _visited() -> Iterator[set[str]]:
    files: set[str] = set()

    def visit(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and (file := _of_project(frame.f_code.co_filename)):
            files.add(file)

    sys.setprofile(visit)
    try:
        yield files
    finally:
        sys.setprofile(None)


def _of_project(file: str) -> str | None:
    """The path of a source file inside of the tree; None for all other code."""
    path = Path(file)
    if not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in SOURCES:
        return None
    return str(path.relative_to(ROOT))


def _road(name: str, what: str, goal: int, files: set[str]) -> Count:
    return Count(name=name, what=what, value=len(files), goal=goal, files=tuple(sorted(files)))


def sizes() -> Iterator[Count]:
    """Lines, files and words of what is in version control."""
    source = _tracked("*.py", SOURCES)
    tests = _tracked("*.py", ("tests",))
    pages = _tracked("*.md", ("docs",))
    yield Count(name="lines", what="lines of solver, service and client", value=_lines(source), goal=62_000)
    yield Count(name="files", what="files of solver, service and client", value=len(source), goal=450)
    yield Count(name="tests", what="lines of tests", value=_lines(tests), goal=50_000)
    words = sum(len(path.read_text().split()) for path in pages)
    yield Count(name="words", what="words of docs", value=words, goal=60_000)


def _tracked(pattern: str, folders: Sequence[str]) -> list[Path]:
    names = subprocess.run(
        ["git", "ls-files", *(f"{folder}/{pattern}" for folder in folders)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.splitlines()
    return [path for name in names if (path := ROOT / name).exists()]


def _lines(files: Sequence[Path]) -> int:
    return sum(len(path.read_text().splitlines()) for path in files)


if __name__ == "__main__":
    main()
