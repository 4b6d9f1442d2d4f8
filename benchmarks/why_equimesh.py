"""Our meshes compared with those of Mmg, BAMG, Gmsh, TMOP and FEALPy, with as many vertices, for the page on peers.

Every measurement goes into `benchmarks/why_equimesh.json` at once, and replaces an older one. The tables of
`docs/background/why-equimesh.md` are made of this record.

pip install mmgpy gmsh mfem fealpy        # those that are not installed are left out; BAMG: apt-get install freefem++
python benchmarks/why_equimesh.py --functions layer --meshers Mmg2d equimesh
python benchmarks/why_equimesh.py         # all of it: a quarter of an hour, most of it for TMOP
python benchmarks/why_equimesh.py --write     # the tables of the page, without new measurements
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from equimesh_cli.report import THREAD_COUNTS

if __name__ == "__main__":
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))  # before the linear algebra is loaded

import movers
import remeshers
from made_meshes import Made, Measured, measure

import equimesh as em

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "background" / "why-equimesh.md"
RECORD = ROOT / "benchmarks" / "why_equimesh.json"
BEGIN, END = "<!-- why_equimesh.py: begin -->", "<!-- why_equimesh.py: end -->"
"""The marks around the tables of the page."""
POINTS = 65
FUNCTIONS = {
    "layer": ("a boundary layer, and a hill along the other direction", "(1 - exp(15*(x - 1))) * sin(pi*y)"),
    "tanh60": ("a steep oblique front", "tanh(60*(x + y/2 - 0.75))"),
    "ring": ("a Gaussian ring", "exp(-200*((x - 0.5)**2 + (y - 0.5)**2 - 0.09)**2)"),
    "wave": ("a steep front that bends", "tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))"),
}
ORDER = (
    *(f"equimesh, {kind}" for kind in movers.OWN),
    *("Mmg2d", "BAMG", "Gmsh, sizes alone"),
    *(f"TMOP {number}: {kind}" for kind, number in movers.TMOP_METRICS.items()),
    "FEALPy, GFMMPDE",
)
"""The meshers in the order of the tables."""
Mesher = Callable[[em.Expression, int], Made]
Values = Callable[[Measured], float]


def meshers() -> Iterator[tuple[str, Mesher]]:
    """Name and call of every mesher that is installed."""
    for kind in movers.OWN:
        yield f"equimesh, {kind}", partial(movers.own, kind)
    if has("mmgpy"):
        yield "Mmg2d", remeshers.mmg
    if remeshers.has_freefem():
        yield "BAMG", remeshers.bamg
    if has("gmsh"):
        yield "Gmsh, sizes alone", remeshers.gmsh
    if has("mfem"):
        for kind, number in movers.TMOP_METRICS.items():
            yield f"TMOP {number}: {kind}", partial(movers.tmop, kind)
    if has("fealpy"):
        yield "FEALPy, GFMMPDE", movers.fealpy


def has(name: str) -> bool:
    """Whether a package is installed."""
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def row(mesher: str, meshes: dict[str, dict[str, Any]]) -> str:
    """The line of a mesher: both errors for each function; the smallest and largest rates and angles of all of them."""
    found = {name: Measured(**meshes[name][mesher]) for name in meshes if mesher in meshes[name]}
    errors = [f"{found[name].l2:.2g}, {found[name].h1:.2g}" if name in found else "" for name in meshes]
    rates = [f"{float(f'{rate:.2g}'):,.0f}" for rate in _ends(found, lambda one: one.rate)]
    smallest = _ends(found, lambda one: one.smallest_angle)[0]
    largest = _ends(found, lambda one: one.largest_angle)[1]
    cells = [mesher, *errors, " to ".join(dict.fromkeys(rates)), f"{smallest:.1f} to {largest:.1f}"]
    return f"| {' | '.join(cells)} |"


def _ends(found: dict[str, Measured], value: Values) -> tuple[float, float]:
    values = [value(one) for one in found.values()]
    return min(values), max(values)


def tables(record: dict[str, Any]) -> Iterator[str]:
    """The lines of the page: the command and the versions, the functions, and a table with a line for each mesher."""
    points, known, meshes = record["points"], record["versions"], record["meshes"]
    yield f"`python benchmarks/why_equimesh.py --points {points}` with {', '.join(known.values())}."
    yield ""
    for name in meshes:
        text, formula = FUNCTIONS[name]
        yield f"- `{name}`: {text}, `{formula}`"
    yield from (
        "",
        f"| mesh | {' | '.join(meshes)} | vertices per CPU second | angles |",
        "|---" * (len(meshes) + 3) + "|",
    )
    for mesher in sorted({mesher for found in meshes.values() for mesher in found}, key=ORDER.index):
        yield row(mesher, meshes)


def versions() -> dict[str, str]:
    """Name and version of what is installed, by name."""
    packages = {"equimesh": "equimesh", "mmgpy": "mmgpy", "Gmsh": "gmsh", "PyMFEM": "mfem", "FEALPy": "fealpy"}
    found = {name: f"{name} {version(package)}" for name, package in packages.items() if has(package)}
    if remeshers.has_freefem():
        command = [remeshers.FREEFEM, "-nw", "-v", "1", os.devnull]
        printed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        banner = re.search(r"FreeFem\+\+ v(\S+)", printed)
        found["FreeFEM"] = f"FreeFEM {banner[1] if banner else 'of unknown version'}"
    return found | {"Python": f"Python {platform.python_version()}"}


def recorded(points: int) -> dict[str, Any]:
    """The record as it is in the file now; an empty one for another number of points."""
    text = RECORD.read_text() if RECORD.exists() else ""
    if text and (record := json.loads(text))["points"] == points:
        return dict(record)
    return {"points": points, "versions": {}, "meshes": {}}


def remember(name: str, mesher: str, found: Measured, points: int) -> None:
    """Put a measurement into the record, which another process may have written since."""
    with RECORD.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        record = recorded(points)
        record["versions"] |= versions()
        record["meshes"].setdefault(name, {})[mesher] = asdict(found)
        RECORD.write_text(json.dumps(record, indent=1) + "\n")


def write(section: str) -> None:
    """Put the tables between the marks of the page."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        sys.exit(f"{PAGE}: the marks of the tables are not there")
    PAGE.write_text(f"{before}{BEGIN}\n\n{section}\n\n{END}{after}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=POINTS, help="points a side")
    parser.add_argument("--functions", nargs="+", choices=[*FUNCTIONS], default=[*FUNCTIONS])
    parser.add_argument("--meshers", nargs="+", default=[""], help="beginnings of their names")
    parser.add_argument("--write", action="store_true", help="only write the tables of the page")
    options = parser.parse_args()
    if not options.write:
        for name in options.functions:
            u = em.Expression(FUNCTIONS[name][1])
            for mesher, make in meshers():
                if mesher.startswith(tuple(options.meshers)):
                    found = measure(make(u, options.points), u, options.points)
                    print(f"{name}, {mesher}: {found}", flush=True)
                    remember(name, mesher, found, options.points)
    elif options.points == POINTS:
        write("\n".join(tables(recorded(POINTS))))


if __name__ == "__main__":
    main()
