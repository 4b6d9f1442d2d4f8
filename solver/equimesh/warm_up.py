"""The warm-up: one small solve of each kind, which together need every compiled loop; the most frequent kinds first.

``python -m equimesh.warm_up`` compiles all loops that are kept nowhere yet. With ``--archive`` it makes an archive of
all loops, which travels with a wheel or an image.
"""

import argparse
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numba.core import config

import equimesh
from equimesh.io.write import write_mesh
from equimesh.least_error.block_levels import block_levels
from equimesh.least_error.block_mesh import BlockMesh
from equimesh.least_error.lifting import Lifting, mended
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import lattice_of, require_degree
from equimesh.numerics import machine_code, processor
from equimesh.numerics.compiled import Origin, kept_entries, origins
from equimesh.quality.faces import measure_faces
from equimesh.rounds.round import adapt_round

_config: Any = config
Cases: TypeAlias = tuple[tuple[equimesh.Monitor, int, equimesh.Domain, equimesh.Schwarz | None], ...]


def warm_up() -> None:
    """Do everything once that is slow or takes permanent memory the first time: all kernels are compiled."""
    warm_up_basics()
    warm_up_rare()


def warm_up_rare(*, backwards: bool = False) -> None:
    """The part for all problems that are not the most frequent ones.

    Of two processes that compile, one does it ``backwards``: it compiles what the other one comes to last.
    """
    u = _formula()
    ring = equimesh.AnnulusSector()
    plain, weight = equimesh.ArcLength(u=u), equimesh.Weight(rho=equimesh.Expression("1 + x"))
    nodes = equimesh.Mesh.uniform(equimesh.Grid(n_xi=9, n_eta=9))
    nodal = equimesh.ArcLength(u=equimesh.NodalField(mesh=nodes, values=nodes.x * nodes.y))
    curved = equimesh.Smoothed(monitor=equimesh.Intersection(monitors=(equimesh.Curvature(u=u), weight)))
    schwarz = equimesh.Schwarz(subdomains=(2, 2), overlap=2)
    paper = replace(schwarz, transmission=equimesh.Classical(), max_iterations=2)
    cases: Cases = (
        (plain, 9, equimesh.Rectangle(), paper),
        (plain, 9, equimesh.Rectangle(), schwarz),
        (plain, 193, equimesh.Rectangle(), schwarz),  # this many points are swept in strips, the last of them smaller
        (nodal, 33, equimesh.Rectangle(), None),
        (plain, 33, ring, schwarz),
        (plain, 33, ring, None),
        (plain, 7, equimesh.AnnulusSector(closed=True), None),
        (equimesh.Weight(rho=equimesh.Expression("1 + y")), 9, equimesh.Rectangle(periodic="x"), None),
        (curved, 33, equimesh.Rectangle(), None),
        (equimesh.Weight(rho=weight.rho, map="gradient"), 33, equimesh.Rectangle(), None),
        (equimesh.LeastError(u=u, norm="h1"), 9, ring, None),
    )
    parts: list[Callable[[], object]] = [
        *(partial(_solve_and_measure, (case,)) for case in cases),
        *(partial(_round_of_degree, nodes, u, degree) for degree in (1, 3)),
        partial(_measure_and_transfer, nodes, plain, weight),
        partial(_warm_up_blocks, nodes, u),
        partial(_write, cases[:1]),
    ]
    for part in reversed(parts) if backwards else parts:
        part()


def _round_of_degree(nodes: equimesh.Mesh, u: equimesh.Field, degree: int) -> None:
    lattice = lattice_of(nodes, degree)
    adapt_round(nodes, u.evaluate(lattice.x, lattice.y)[0], degree=require_degree(degree))


def _measure_and_transfer(nodes: equimesh.Mesh, plain: equimesh.Monitor, weight: equimesh.Weight) -> None:
    fine_grid = equimesh.Grid(n_xi=400, n_eta=400)  # so many cells are measured on a sample of them
    equimesh.measure(equimesh.Mesh.uniform(fine_grid), equimesh.Problem(monitor=plain, grid=fine_grid).monitor)
    blocks = Mesh(points=nodes.points, cells=nodes.cells, sides=nodes.sides)
    measure_faces(blocks), equimesh.measure(blocks, weight, uniform=blocks)
    carried = equimesh.MeshValues(np.round(nodes.x + nodes.y), transfer="conservative")
    averages = equimesh.MeshValues(nodes.x[1:, 1:], transfer="conservative", location="cells")
    equimesh.transfer(nodes, {"u": carried, "v": averages}, equimesh.Mesh(nodes.x**2, nodes.y))


def _write(cases: Cases) -> None:
    with TemporaryDirectory() as folder:
        write_mesh(Path(folder) / "mesh.vtu", _solve_and_measure(cases))


def warm_up_basics() -> None:
    """The part for the most frequent problems: arc length, auto and least error of formulas and samples, on a grid."""
    np.linalg.norm(np.ones((64, 64)) @ np.ones((64, 64)))
    steep = equimesh.Expression("tanh(200*((x-0.5)**2 + (y-0.5)**2 - 0.09))")
    u, axis = _formula(), np.linspace(0.0, 1.0, 9)
    plain, rectangle = equimesh.ArcLength(u=u), equimesh.Rectangle()
    sampled = equimesh.ArcLength(u=equimesh.GridSamples(x=axis, y=axis, values=np.add.outer(axis, np.tanh(axis))))
    sent = pickle.loads(pickle.dumps(sampled))  # as the service sends it: its arrays are of another kind for Numba
    fine = np.linspace(0.0, 1.0, 140)  # so many samples are evaluated in another way
    for samples in (sampled.u, sent.u, equimesh.GridSamples(x=fine, y=fine, values=np.add.outer(fine, fine))):
        for order in range(3):
            samples.evaluate(axis, axis, order=order)
    cases: Cases = (
        (plain, 33, rectangle, None),
        (plain, 193, rectangle, None),  # this many points are swept in strips, the last of them smaller
        (sampled, 33, rectangle, None),
        (sent, 33, rectangle, None),
        (equimesh.ArcLength(u=steep, a=1.0, b=0.0), 9, rectangle, None),  # relaxed
        (equimesh.Auto(u=u, purpose="finite_element"), 9, rectangle, None),
        (equimesh.Auto(u=u, purpose="interpolation"), 9, rectangle, None),
    )
    _solve_and_measure(cases)


def _formula() -> equimesh.Expression:
    return equimesh.Expression("tanh(8*(x + y/2 - 0.75))")


def _solve_and_measure(cases: Cases) -> equimesh.MeshData:
    """Solve on grids, and ask for all that an answer has; returns the last mesh with its data."""
    for monitor, points, domain, settings in cases:
        grid = equimesh.Grid(n_xi=points, n_eta=points)
        problem = equimesh.Problem(monitor=monitor, grid=grid, domain=domain)
        solution = equimesh.solve(problem, settings, threads=1, check=False)
        data, _ = solution.data(), (solution.certificate, solution.quality, solution.against_uniform)
        problem.monitor.weakened(0.5).metric(solution.mesh.x, solution.mesh.y)
    return data


def _warm_up_blocks(nodes: equimesh.Mesh, u: equimesh.Field) -> None:
    """Solve on a mesh in blocks, mend a fold, and carry fields between meshes that are no grids."""
    domain = equimesh.Blocks.of_mesh(nodes.points, nodes.cells, nodes.sides)
    for least in _least_errors(u):
        solution = equimesh.solve(equimesh.Problem(monitor=least, domain=domain), threads=1, check=False)
        solution.data(), solution.certificate, solution.quality, solution.against_uniform
    fine = equimesh.Mesh.uniform(equimesh.Grid(n_xi=37, n_eta=37))  # so many points that there is a coarser level
    levels = block_levels(equimesh.Blocks.of_mesh(fine.points, fine.cells, fine.sides).mesh)
    Lifting(*levels).lifted(np.ones((2, levels[0].points)), cubic=True)
    adapt_round(domain.mesh, u.evaluate(*domain.mesh.points.T)[0], domain)
    finest = BlockMesh.of(domain, block_levels(domain.mesh)[-1])
    valid = finest.first.unknowns
    finest.cells.apart(4)
    mended(finest.chart, finest.cells, valid, valid + 9.0 * finest.chart.free * np.sin(9.0 * valid))
    first, then = (Mesh(points=p, cells=nodes.cells, sides={}) for p in (nodes.points, nodes.points**2))
    carried = equimesh.MeshValues(np.round(first.x + first.y), transfer="conservative")
    averages = equimesh.MeshValues(np.arange(64.0), transfer="conservative", location="cells")
    equimesh.transfer(first, {"u": carried, "v": averages, "w": first.x}, then)


def _least_errors(u: equimesh.Field) -> Iterator[equimesh.LeastError]:
    """Least-error monitors that together need all compiled loops of a descent."""
    yield equimesh.LeastError(u=u)
    yield equimesh.LeastError(u=u, orthogonality=40.0)
    yield equimesh.LeastError(u=u, norm="h1")
    yield equimesh.LeastError(u=u, cells="triangle")
    yield equimesh.LeastError(u=u, norm="h1", cells="triangle")
    yield equimesh.LeastError(u=u, degree=2)
    yield equimesh.LeastError(u=u, norm="h1", degree=2)


def make_archive(path: Path | None = None, *, level: str | None = None) -> tuple[Path, int]:
    """Write every loop as an archive, compiled where it is kept nowhere yet; return its path and the number of loops.

    ``path`` is by default the place inside the package where the loops are looked for; ``level`` is by default that of
    this processor, which must be able to run its code. Raises :class:`RuntimeError` where loops of another level were
    used in this process, where Numba's code needs a library of Intel, and where no folder keeps what is compiled.
    """
    if _config.USING_SVML:
        raise RuntimeError("Numba found Intel's library of vector functions; set NUMBA_DISABLE_INTEL_SVML=1")
    if level not in (None, processor.level().name):
        if origins:
            raise RuntimeError(f"this process has used loops of the level {processor.level().name}; take a new one")
        _config.CPU_NAME, _config.CPU_FEATURES = level, ""
        processor.level.cache_clear()
        processor.tag.cache_clear()
    warm_up()
    path = machine_code.archive_path() if path is None else path
    return path, machine_code.write_archive(path, sorted(kept_entries().items()))


def _main() -> None:
    parser = argparse.ArgumentParser(prog="python -m equimesh.warm_up", description="Compile every numerical loop.")
    parser.add_argument(
        "--archive",
        metavar="FILE",
        nargs="?",
        const="",
        help="write all loops to an archive; without FILE to the place in the package where they are looked for",
    )
    parser.add_argument(
        "--level", choices=[*processor.LEVELS], help="the level of processors; by default that of this machine"
    )
    options = parser.parse_args()
    if options.archive is None:
        if options.level is not None:
            parser.error("--level is for an archive: add --archive")
        warm_up()
        found = list(origins.values())
        print(", ".join(f"{found.count(origin)} {origin}" for origin in Origin))
        return
    try:
        path, number = make_archive(Path(options.archive) if options.archive else None, level=options.level)
    except (RuntimeError, OSError) as error:
        sys.exit(f"no archive was made: {error}")
    print(f"{path}: {number} loops, {os.path.getsize(path) / 1e6:.1f} MB")


if __name__ == "__main__":
    _main()
