"""Whether a change keeps the meshes: some 300 problems of all kinds, solved by two trees and compared node by node.

The problems are documents of the HTTP interface, so a change of names in Python does not touch them: functions from a
seed and those of the tests, every monitor, domain, boundary and start, Schwarz iterations of every condition and
ordering, blocks, rounds with values at nodes, sequences, and loops with a solver.

    python benchmarks/golden.py record before.npz        one CPU minute; in the tree before the change
    python benchmarks/golden.py record after.npz         in the tree after it
    python benchmarks/golden.py compare before.npz after.npz

``compare`` prints the largest distance between two nodes, in sizes of the domain, for each kind of problem, and ends
with 1 where a problem is missing, has other counts, or moved by more than ``--within``.
"""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from functions import FUNCTIONS
from random_functions import random_functions

import equimesh as em
from equimesh.specs import build

Array = npt.NDArray[np.float64]
Document = Mapping[str, Any]

SEED = 271
RING = {"kind": "annulus_sector", "radii": [1.0, 2.0]}
CLOSED_RING = {"kind": "annulus_sector", "radii": [1.0, 2.0], "closed": True}
BOX = {"kind": "rectangle", "x": [-1.0, 2.0], "y": [0.0, 1.0]}
PERIODIC = {"kind": "rectangle", "periodic": "x"}
CHANNEL = {
    "kind": "quadrilateral",
    "bottom": {"x": "2*t", "y": "0.2*sin(pi*t)"},
    "right": {"points": [[2.0, 0.0], [2.0, 1.0]]},
    "top": {"points": [[0.0, 1.0], [0.7, 1.1], [1.4, 1.05], [2.0, 1.0]]},
    "left": {"points": [[0.0, 0.0], [0.0, 1.0]]},
}
DOMAINS = {"ring": RING, "closed ring": CLOSED_RING, "box": BOX, "periodic": PERIODIC, "channel": CHANNEL}
L_SHAPE = {
    "kind": "blocks",
    "vertices": dict(zip("abcdefgh", [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1], [0, 2], [1, 2]], strict=True)),
    "blocks": [
        {"corners": ["a", "b", "e", "d"], "cells": [10, 10]},
        {"corners": ["b", "c", "f", "e"], "cells": [10, None]},
        {"corners": ["d", "e", "h", "g"], "cells": [None, 10]},
    ],
}
ONE_BLOCK = {
    "kind": "blocks",
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [16, 16]}],
}
HOLE = {
    "kind": "blocks",
    "vertices": {"i": [1, 0], "o": [2, 0]},
    "curves": {
        "inner": {"circle": {"center": [0, 0], "radius": 1}},
        "outer": {"circle": {"center": [0, 0], "radius": 2}},
    },
    "edges": [{"from": "i", "to": "i", "on": "inner"}, {"from": "o", "to": "o", "on": "outer"}],
    "blocks": [{"corners": ["i", "o", "o", "i"], "cells": [10, 40]}],
}
BLOCKS = {"an L": L_SHAPE, "one block": ONE_BLOCK, "a ring": HOLE}
SMALL = {"n_xi": 17, "n_eta": 17}


class Problem(NamedTuple):
    """A ``kind``, under which the results are listed, a name, and what makes the nodes, of shape ``(v, 2)``."""

    kind: str
    name: str
    nodes: Callable[[], Array]


def problems() -> Iterator[Problem]:
    """All problems, in an order that does not change."""
    documents = (grids, metrics, domains, schwarz, samples, blocks)
    for made in documents:
        for number, document in enumerate(made()):
            yield Problem(made.__name__, f"{made.__name__} {number}", lambda document=document: solved(document))  # type: ignore[misc]
    for number in range(12):
        u = random_functions(SEED + 3, 12)[number].u
        yield Problem("rounds", f"rounds {number}", lambda u=u: adapted(u))  # type: ignore[misc]
        yield Problem("sequences", f"sequences {number}", lambda u=u: followed(u))  # type: ignore[misc]


def grids() -> Iterator[Document]:
    """Least error and the best monitor on the unit square."""
    for number, u in enumerate(random_functions(SEED, 40)):
        grid = {"n_xi": 17 + 4 * (number % 3), "n_eta": 17 + 8 * (number % 2)}
        norm = ("l2", "h1")[number % 2]
        yield {"monitor": {"kind": "least_error", "u": u.u, "norm": norm}, "grid": grid}
        if number % 4 == 0:
            yield {"monitor": {"kind": "auto", "u": u.u, "norm": norm}, "grid": grid}
    u = FUNCTIONS["ring"].u
    for settings in (
        {"distortion": 2.0},
        {"smoothness": 10.0},
        {"rectilinear": True},
        {"orthogonality": 60.0},
    ):
        yield {"monitor": {"kind": "least_error", "u": u, **settings}, "grid": SMALL}
    for cells in ("quad", "triangle"):
        yield {"monitor": {"kind": "least_error", "u": u}, "grid": SMALL, "cells": cells}
    yield {"monitor": {"kind": "auto", "u": u, "for": "finite_volume"}, "grid": SMALL}
    yield {"monitor": {"kind": "auto", "u": u}, "target": {"norm": "l2", "error": 3e-2}}


def metrics() -> Iterator[Document]:
    """Metrics on the unit square: every kind, boundary, start and mode."""
    for name, (u, _) in FUNCTIONS.items():
        yield {"monitor": {"kind": "arc_length", "u": u}, "grid": SMALL}
        yield {"monitor": {"kind": "curvature", "u": u, "smoothing": 0.05}, "grid": SMALL}
        if name in {"paper", "sine", "ring", "gauss"}:
            for boundary in ("trace", "equidistributed_1d", "orthogonal"):
                for initial in ("nested", "uniform"):
                    arc_length = {"kind": "arc_length", "u": u, "a": 0.5, "b": 0.1, "scaled": False}
                    yield {"monitor": arc_length, "grid": SMALL, "boundary": boundary, "initial": initial}
            yield {"monitor": {"kind": "curvature", "u": u, "isotropic": True}, "grid": SMALL, "mode": "tight"}
            yield {"monitor": {"kind": "arc_length", "u": u, "orthogonality": 70.0}, "grid": SMALL}
    rho = "1 + 10*exp(-50*((x - 0.5)**2 + (y - 0.5)**2))"
    for way in ("lines", "gradient"):
        yield {"monitor": {"kind": "weight", "rho": rho, "map": way}, "grid": SMALL}
    tensor = {"m11": "1 + 9*exp(-20*(x - 0.5)**2)", "m12": "0", "m22": "1 + y"}
    yield {"monitor": {"kind": "tensor", **tensor}, "grid": SMALL}


def domains() -> Iterator[Document]:
    """Every monitor on other domains with four sides."""
    for domain in DOMAINS.values():
        for number, u in enumerate(("tanh(6*(x - 0.4*y - 0.5))", "exp(-4*((x - 0.8)**2 + (y - 0.6)**2))")):
            around = {"kind": "annulus_sector", "closed": True}.items() <= domain.items()
            if domain is PERIODIC:
                u = ("sin(2*pi*x)*y", "tanh(4*sin(2*pi*x)) + y")[number]
            for monitor in ("least_error", "auto", "arc_length", "curvature"):
                smooth = {"smoothing": 0.1} if monitor == "curvature" else {}
                grid = {"n_xi": 17, "n_eta": 33 if around else 17}
                yield {"monitor": {"kind": monitor, "u": u, **smooth}, "domain": domain, "grid": grid}


def schwarz() -> Iterator[Document]:
    """Schwarz iterations of every condition, ordering, acceleration and solver."""
    monitor = {"kind": "arc_length", "u": FUNCTIONS["paper"].u}
    conditions = ("optimized", "classical", "linear_robin", "nonlinear_robin")
    for condition in conditions:
        for subdomains in ([2, 1], [2, 2], [1, 3]):
            for ordering in ("parallel", "alternating", "symmetric", "coloured"):
                settings = {"subdomains": subdomains, "ordering": ordering, "transmission": {"kind": condition}}
                yield {"monitor": monitor, "grid": {"n_xi": 25, "n_eta": 25}, "schwarz": settings}
        for changed in (
            {"acceleration": "none", "line_correction": 0, "max_iterations": 400},
            {"acceleration": "anderson", "line_correction": 1},
            {"acceleration": "newton", "line_correction": 0},
            {"local_solver": "newton"},
        ):
            settings = {"subdomains": [2, 1], "transmission": {"kind": condition}, **changed}
            yield {"monitor": monitor, "grid": {"n_xi": 21, "n_eta": 21}, "schwarz": settings}


def samples() -> Iterator[Document]:
    """Samples of a function on a tensor grid, and values of the last mesh."""
    axis = np.linspace(0.0, 1.0, 33)
    for name in ("paper", "sine", "ring", "tanh20", "gauss", "wave"):
        x, y = np.meshgrid(axis, axis, indexing="ij")
        (values,) = em.Expression(FUNCTIONS[name].u).evaluate(x, y)
        source = {"grid": {"x": axis.tolist(), "y": axis.tolist(), "values": values.tolist()}}
        for kind in ("least_error", "arc_length", "auto"):
            yield {"monitor": {"kind": kind, "u": source}, "grid": SMALL}


def blocks() -> Iterator[Document]:
    """Least error and the best monitor on blocks, by one descent and by a Schwarz iteration between them."""
    for domain in BLOCKS.values():
        for number in range(4):
            u = random_functions(SEED + 2, 4)[number].u
            for norm in ("l2", "h1"):
                yield {"monitor": {"kind": "least_error", "u": u, "norm": norm}, "domain": domain}
        yield {"monitor": {"kind": "auto", "u": "tanh(8*(x + y - 1))"}, "domain": domain}
    yield {"monitor": {"kind": "least_error", "u": "tanh(8*(x + y - 1))"}, "domain": L_SHAPE, "schwarz": {}}


def solved(document: Document) -> Array:
    """The nodes of the mesh that a document describes."""
    return np.asarray(build(document).solve(threads=1, check=False).mesh.points)


def adapted(u: str) -> Array:
    """The nodes after three rounds with a "solver" that interpolates."""
    field = em.Expression(u)
    return np.asarray(em.adapt(lambda mesh: field.evaluate(mesh.x, mesh.y)[0], 17, rounds=3, threads=1).mesh.points)


def followed(u: str) -> Array:
    """The nodes after four steps in which the function moves to the right."""
    grid = em.Grid(n_xi=17, n_eta=17)
    sequence = em.Sequence(em.Problem(monitor=em.LeastError(u=em.Expression(u)), grid=grid), check=False)
    for time in (0.01, 0.02, 0.03, 0.04):
        sequence.step(em.Expression(re.sub(r"\bx\b", f"(x - {time})", u)))
    return np.asarray(sequence.mesh.points)


def record(path: str) -> None:
    """Solve all problems and write the nodes of each."""
    found: dict[str, Array] = {}
    for problem in problems():
        try:
            with warnings.catch_warnings(action="ignore"):
                found[problem.name] = problem.nodes()
        except em.EquimeshError as error:
            print(f"{problem.name}: {type(error).__name__}: {error}")
    np.savez_compressed(path, **found)
    print(f"{len(found)} problems solved")


def compare(before: str, after: str, within: float) -> bool:
    """Print the largest move of a node for each kind of problem; whether all are at most ``within``."""
    with np.load(before) as old, np.load(after) as new:
        lost = sorted(set(old) ^ set(new))
        moves = {name: _move(old[name], new[name]) for name in old if name in new}
    for name in lost:
        print(f"{name}: only in one of the files")
    print(f"{'':12} {'problems':>8} {'equal':>6} {'largest move':>13}")
    for kind in dict.fromkeys(name.split()[0] for name in moves):
        of_kind = [move for name, move in moves.items() if name.split()[0] == kind]
        print(f"{kind:12} {len(of_kind):8} {of_kind.count(0.0):6} {max(of_kind):13.1e}")
    moved = {name: move for name, move in moves.items() if not move <= within}
    for name, move in moved.items():
        print(f"{name}: moved by {move:.1e}")
    return not lost and not moved


def _move(old: Array, new: Array) -> float:
    if old.shape != new.shape:
        return np.inf
    return float(np.abs(old - new).max() / np.ptp(old, axis=0).max())


def main(arguments: Sequence[str] | None = None) -> int:
    """Record the meshes of this tree, or compare two records."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("file")
    compared = commands.add_parser("compare")
    compared.add_argument("before")
    compared.add_argument("after")
    compared.add_argument("--within", type=float, default=1e-9, help="the largest move that is no change")
    options = parser.parse_args(arguments)
    if options.command == "record":
        record(options.file)
        return 0
    return 0 if compare(options.before, options.after, options.within) else 1


if __name__ == "__main__":
    sys.exit(main())
