"""What a start costs: CPU time of all its processes, and how many loops it compiles.

A command is counted to its end, a service until `/readyz` answers 200 for the first time: with an empty folder for
compiled loops, with an archive in the package, and with a folder that has all loops. The services take a copy of the
package, so the archive of this checkout does not count; loops that are missing are compiled first. So is the bytecode
of all modules, as pip does.

    python benchmarks/cold_start.py                    # without the folder that is empty
    python benchmarks/cold_start.py --parts commands
    python benchmarks/cold_start.py --parts empty      # a minute of CPU time
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median

from costs.rows import Row, lines
from latency import cpu_seconds
from load import service

import equimesh
from equimesh.numerics.machine_code import cache_path

PARTS = ("commands", "warm", "archive", "empty")
WORKERS = 2
# Of each command, and its goal in CPU seconds.
COMMANDS = {
    "import equimesh": (["-c", "import equimesh"], 0.525),
    "equimesh --help": (["-m", "equimesh_cli", "--help"], 0.2),
    "equimesh config": (["-m", "equimesh_cli", "config"], 0.3),
}
SERVICES = {"warm": ("all loops in the folder", 5.0), "archive": ("an archive", 10.0), "empty": ("no loops", None)}


def commands(runs: int) -> Iterator[Row]:
    """The CPU time of each command, the median of so many runs after a first one."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    for arguments, _ in COMMANDS.values():
        _command(arguments)
    for what, (arguments, goal) in COMMANDS.items():
        yield Row(what=what, value=median(_command(arguments) for _ in range(runs)), unit="s", goal=goal)


def _command(arguments: Sequence[str]) -> float:
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{arguments} ended with status {process.returncode}")
    return used.ru_utime + used.ru_stime


def services(parts: Sequence[str], folder: Path) -> Iterator[Row]:
    """The CPU time of services until they are ready, and the number of loops that each of them compiles."""
    chosen = [part for part in SERVICES if part in parts]
    if not chosen:
        return
    variables, ignored = {"PYTHONPATH": str(folder), "EQUIMESH_WARM_UP": "all"}, shutil.ignore_patterns("archives")
    shutil.copytree(Path(equimesh.__file__).parent, folder / "equimesh", ignore=ignored)
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    start(folder / "bytecode", {**variables, "EQUIMESH_WARM_UP": "none"})
    for part in chosen:
        what, goal = SERVICES[part]
        if part == "warm":
            _warm_up([], variables)
            shutil.copytree(
                cache_path(), folder / part, ignore=shutil.ignore_patterns(".*")
            )  # nobody else writes there
        if part == "archive":
            _warm_up(["--archive"], variables)
        if part == "empty":
            shutil.rmtree(folder / "equimesh" / "numerics" / "archives", ignore_errors=True)
        seconds, compiled = start(folder / part, variables)
        yield Row(what=f"a service until it is ready, {what}", value=seconds, unit="s", goal=goal)
        if part != "empty":
            yield Row(what=f"loops that it compiles, {what}", value=compiled, unit="", goal=0.0)


def _warm_up(arguments: Sequence[str], variables: dict[str, str]) -> None:
    command = [sys.executable, "-m", "equimesh.warm_up", *arguments]
    subprocess.run(command, env={**os.environ, **variables}, check=True, stdout=subprocess.DEVNULL)


def start(loops: Path, variables: dict[str, str]) -> tuple[float, int]:
    """CPU seconds of a service until it is ready, and how many loops its processes have compiled until it ends.

    ``loops`` is its folder for them.
    """
    before, variables = kept(loops), {**variables, "EQUIMESH_CACHE_DIR": str(loops)}
    with tempfile.TemporaryDirectory() as data, service(Path(data), WORKERS, variables=variables) as (_, pid):
        seconds = cpu_seconds(pid)
    return seconds, len(kept(loops) - before)


def kept(loops: Path) -> set[tuple[str, int]]:
    """The loops in a folder, each with the time when it was written: those that are compiled anew differ."""
    found = (file for file in loops.glob("*/*") if not file.name.startswith("."))
    return {(file.name, file.stat().st_mtime_ns) for file in found}


def rows(parts: Sequence[str], runs: int) -> Iterator[Row]:
    """The rows of these parts."""
    if "commands" in parts:
        yield from commands(runs)
    with tempfile.TemporaryDirectory() as folder:
        yield from services(parts, Path(folder))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each row, as soon as it is measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS[:3], help="what is measured (not: empty)")
    parser.add_argument("--runs", type=int, default=5, help="of each command (5)")
    options = parser.parse_args(arguments)
    for line in lines(rows(options.parts, options.runs)):
        print(line, flush=True)
    print(f"(load {os.getloadavg()[0]:.1f})")


if __name__ == "__main__":
    main()
