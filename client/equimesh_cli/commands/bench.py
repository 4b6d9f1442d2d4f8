"""`equimesh bench`: the cost of a mesh on this machine."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from equimesh_cli.compiling import load_solver
from equimesh_cli.exits import Exit, Refused
from equimesh_cli.parser import add_command

if TYPE_CHECKING:
    from equimesh_cli.benchmark.rows import Row

T = TypeVar("T")

EXAMPLES = """\
examples:
  equimesh bench --quick            a minute
  equimesh bench                    some minutes, most for Newton's method
  equimesh bench --large --peers    also 4097 x 4097 points; Mmg2d and Gmsh
  equimesh bench --json bench.json

goals are for an otherwise idle machine; needs the solver: pip install 'equimesh[solver]'

"""
EXITS = {
    Exit.INPUT: "bad usage, or the solver is not installed",
}


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


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "bench",
        help="measure what a mesh costs on this machine",
        description="Measure CPU time, memory and steps of solves on this machine, compared with their goals.",
        examples=EXAMPLES,
        exits=EXITS,
    )
    parser.add_argument("--quick", action="store_true", help="at most 257 points a side; goals are for larger meshes")
    parser.add_argument("--large", action="store_true", help=f"also {HUGE} points a side: 2 GB of memory")
    parser.add_argument("--peers", action="store_true", help="also Mmg2d and Gmsh: pip install mmgpy gmsh")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers, too")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Measure, and print every row as soon as it is known."""
    if options.json is not None and not options.json.parent.is_dir():
        raise Refused(f"{options.json.parent}: there is no such folder")
    sizes = replace(
        QUICK if options.quick else FULL,
        huge=HUGE if options.large else None,
        peers=() if not options.peers else QUICK_PEERS if options.quick else PEERS,
    )
    numbers = report(sizes)
    if options.json is not None:
        options.json.write_text(json.dumps(numbers, indent=2) + "\n")
        print(f"wrote {options.json}")
    return Exit.DONE


def report(sizes: Sizes) -> dict[str, Any]:
    """Print the tables, and return them as plain data."""
    load_solver()
    from equimesh_cli.benchmark import newton, peers, rows

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
    import equimesh as em
    from equimesh_cli.benchmark import newton, processes, schwarz, solves

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
