"""`equimesh solve`: a mesh without a service."""

from __future__ import annotations

import argparse
import json
import os
from types import TracebackType
from typing import TYPE_CHECKING, Any

from equimesh_cli.exits import EPILOG, Exit, Refused
from equimesh_cli.options import add_mesh_options, check_options, schwarz_of

if TYPE_CHECKING:
    import equimesh
    from equimesh import Event, Solution

SUFFIXES = (".vtu", ".vtk", ".xdmf", ".xdmf.zip", ".msh", ".npz")
# Read by the linear algebra when it is loaded. Its systems here are many and small: more threads make it slower.
THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# What a solve and its quality measures take; measured at 1025 x 1025 points.
BYTES_PER_POINT = 600
EXAMPLES = """\
examples:
  equimesh solve '(1-exp(15*(x-1)))*sin(pi*y)' -n 64 -o mesh.vtu
  equimesh solve '(1-exp(15*(x-1)))*sin(pi*y)' -n 12 --boundary equidistributed_1d --initial uniform \\
      --subdomains 2x1 --overlap 2 --p 2.3 --compare --plot convergence.png --plot-kind convergence
  equimesh solve -n 33 -- '-x*y'
  equimesh solve --samples u.csv -n 129 -o mesh.msh --cells triangle

needs the solver: pip install 'equimesh[solver]', and [plot] for --plot

"""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "solve",
        help="make a mesh here, without a service",
        description="Make the mesh that is adapted to u in this process, and write it to a file.",
        epilog=EXAMPLES + EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add_mesh_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Solve, write, report."""
    check_options(options, SUFFIXES)
    for name in THREAD_COUNTS:
        os.environ.setdefault(name, "1")
    try:
        import scipy  # noqa: F401  # what the extra brings

        import equimesh as em
    except ImportError as error:
        raise Refused(f"the solver is not installed ({error.name}): pip install 'equimesh[solver]'") from error
    from equimesh_client import Convergence, Quality

    grid = em.Grid(n_xi=options.n_xi, n_eta=options.n_xi if options.n_eta is None else options.n_eta)
    _check_memory(grid)
    try:
        monitor = em.ArcLength(u=_field(em, options), a=options.a, b=options.b)
        problem = em.Problem(monitor=monitor, grid=grid, boundary=em.Boundary(options.boundary))
        with Observer(shown=not options.quiet) as observer:
            solution = em.solve(problem, _schwarz(em, options), initial=em.Initial(options.initial), observe=observer)
    except em.ExpressionError as error:
        raise Refused(pointed(error, options.u)) from error
    except em.SolveError as error:
        if options.json:
            print(json.dumps({**_said(error.solution), "convergence": error.solution.convergence()}, indent=2))
        raise
    files = _write(options, solution)
    quality, convergence = solution.quality.summary(), solution.convergence()
    if options.json:
        print(json.dumps({**_said(solution), "quality": quality, "convergence": convergence, "files": files}, indent=2))
    elif not options.quiet:
        print(f"{grid} points: {solution.message}")
        print(Quality.from_json(quality))
        if options.subdomains is not None:
            print(f"\n{Convergence.from_json(convergence)}")
        for file in files:
            print(f"wrote {file}")
    return Exit.DONE


def _said(solution: Solution) -> dict[str, str]:
    return {"status": solution.status.value, "message": solution.message}


def _check_memory(grid: equimesh.Grid) -> None:
    """Refuse a mesh that this machine cannot hold, before an hour of work comes to that."""
    needed, present = BYTES_PER_POINT * grid.points, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > present:
        raise Refused(
            f"{grid} points need about {needed / 1e9:.0f} GB of memory, and this machine has {present / 1e9:.0f} GB: "
            "take fewer points"
        )


def pointed(error: equimesh.ExpressionError, text: str) -> str:
    """What is wrong with an expression, with a caret under the place."""
    from equimesh_client.errors import caret

    place = error.position
    shown = caret(text, line=place.line, column=place.column) if place is not None else ""
    return f"{error}\n{shown}" if shown else str(error)


def _field(em: Any, options: argparse.Namespace) -> equimesh.Field:
    if options.samples is not None:
        from equimesh.upload import read_samples

        samples: equimesh.Field = read_samples(options.samples.read_bytes(), options.samples.name)
        return samples
    expression: equimesh.Expression = em.Expression(options.u, parameters=dict(options.parameter), t=options.t or 0.0)
    expression.check_finite()
    return expression


def _schwarz(em: Any, options: argparse.Namespace) -> equimesh.Schwarz | None:
    """The solver's own settings: the client's, object for object."""
    asked = schwarz_of(options)
    if asked is None:
        return None
    condition = getattr(em, type(asked.transmission).__name__)
    p = getattr(asked.transmission, "p", None)
    schwarz: equimesh.Schwarz = em.Schwarz(
        subdomains=asked.subdomains,
        overlap=asked.overlap,
        transmission=condition() if p is None else condition(p=p),
        ordering=em.Ordering(asked.ordering),
        tolerance=asked.tolerance,
        max_iterations=asked.max_iterations,
        compare_single_domain=asked.compare_single_domain,
    )
    return schwarz


def _write(options: argparse.Namespace, solution: Solution) -> list[str]:
    """Write the asked files and return their names."""
    files = []
    if options.output is not None:
        from equimesh.io import write_mesh

        write_mesh(options.output, solution.data(), cells=options.cells)
        files.append(str(options.output))
    if options.plot is not None:
        try:
            from equimesh import plot
        except ImportError as error:
            raise Refused("--plot needs matplotlib: pip install 'equimesh[plot]'") from error
        match options.plot_kind:
            case "convergence":
                plot.draw_convergence(solution.convergence(), options.plot)
            case "quality":
                plot.draw_quality(solution.data(), options.plot)
            case _:
                plot.draw_mesh(solution.data(), options.plot, decomposition=solution.decomposition)
        files.append(str(options.plot))
    return files


class Observer:
    """Shows every step of a solve in one line, on a terminal only; a context manager."""

    def __init__(self, *, shown: bool) -> None:
        from tqdm import tqdm

        self._line = tqdm(bar_format="{desc} {elapsed}", disable=None if shown else True, leave=False)

    def __call__(self, event: Event) -> None:
        step = getattr(event, "step", None)
        if step is None:
            said = f"Schwarz iteration {event.iteration}, change {event.change:.1e}"  # type: ignore[union-attr]
        else:
            said = f"Newton step {step} on {event.grid}, residual {event.residual:.1e}"  # type: ignore[union-attr]
        self._line.set_description_str(said)

    def __enter__(self) -> Observer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._line.close()
