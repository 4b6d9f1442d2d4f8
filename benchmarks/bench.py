"""The cost of a mesh on this machine: CPU time, memory and steps of solves, compared with their goals.

Goals are for an otherwise idle machine.

    python benchmarks/bench.py --quick            a minute
    python benchmarks/bench.py                    some minutes, most for Newton's method
    python benchmarks/bench.py --large --peers    also 4097 x 4097 points; Mmg2d and Gmsh
    python benchmarks/bench.py --json bench.json
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from equimesh_cli.report import load_solver

if TYPE_CHECKING:
    from costs.rows import Row

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Points a side of the measured meshes; without ``huge`` that part is left out."""

    large: int = 1025
    small: tuple[int, ...] = (33, 65)
    newton: int = 513
    huge: int | None = None
    peers: tuple[int, ...] = ()
    kernels: bool = True


FULL, QUICK, HUGE, PEERS, QUICK_PEERS = Sizes(), Sizes(large=257, newton=129), 4097, (65, 129), (65,)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print every row as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="at most 257 points a side; goals are for larger meshes")
    parser.add_argument("--large", action="store_true", help=f"also {HUGE} points a side: 2 GB of memory")
    parser.add_argument("--peers", action="store_true", help="also Mmg2d and Gmsh: pip install mmgpy gmsh")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers, too")
    options = parser.parse_args(arguments)
    if options.json is not None and not options.json.parent.is_dir():
        parser.error(f"{options.json.parent}: there is no such folder")
    sizes = replace(
        QUICK if options.quick else FULL,
        huge=HUGE if options.large else None,
        peers=() if not options.peers else QUICK_PEERS if options.quick else PEERS,
    )
    numbers = report(sizes)
    if options.json is not None:
        options.json.write_text(json.dumps(numbers, indent=2) + "\n")
        print(f"wrote {options.json}")


def report(sizes: Sizes) -> dict[str, Any]:
    """Print the tables, and return them as plain data."""
    load_solver()
    from costs import newton, peers, rows

    print(f"{os.cpu_count()} cores; CPU time on one thread, medians of {rows.RUNS} runs\n", flush=True)
    measured: list[Row] = []
    for line in rows.lines(_collect(_rows(sizes), measured)):
        print(line, flush=True)
    if not newton.has_pardiso():
        print(f"\n{newton.PARDISO}: not installed (pip install pypardiso)")
    meshes: list[peers.Meshed] = []
    for n in sizes.peers:
        absent = [name for name in ("mmgpy", "gmsh") if not peers.is_installed(name)]
        print(f"\nabout {n} x {n} vertices" + (f"; not installed: {', '.join(absent)}" if absent else ""), flush=True)
        for line in peers.lines(_collect(peers.compare(n), meshes)):
            print(line, flush=True)
    return {
        "cores": os.cpu_count(),
        "rows": [row.plain() for row in measured],
        "peers": [mesh.plain() for mesh in meshes],
    }


def _rows(sizes: Sizes) -> Iterator[Row]:
    from costs import newton, processes, schwarz, solves

    import equimesh as em

    cheap, tanh = em.Expression(solves.CHEAP), em.Expression(solves.TANH)
    yield solves.cost_of(cheap)
    yield from solves.large(sizes.large)
    yield solves.cost_of(tanh)
    yield from solves.large(sizes.large, tanh, ", tanh")
    yield from solves.threads(sizes.large)
    yield from schwarz.compare(sizes.large)
    for n in sizes.small:
        yield from solves.small(n)
    if sizes.kernels:
        yield from processes.kernels()
    if sizes.huge is not None:
        yield from processes.memory(sizes.huge, sizes.large)
    yield from newton.compare(sizes.newton)


def _collect(items: Iterable[T], into: list[T]) -> Iterator[T]:
    """The items one by one, each also appended to a list."""
    for item in items:
        into.append(item)
        yield item


if __name__ == "__main__":
    main()
