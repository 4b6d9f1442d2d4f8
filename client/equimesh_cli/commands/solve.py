"""`equimesh solve`: a mesh without a service."""

from __future__ import annotations

import argparse
import json
import os
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from equimesh_cli.options.mesh import Picture, add_mesh_options, check_options, picture_of, points_of
from equimesh_cli.parser import CommandError, Exit, add_command
from equimesh_cli.report import announce_compiling, load_solver, told

if TYPE_CHECKING:
    import equimesh
    from equimesh import Solution

BYTES_PER_POINT = 600
"""Memory of a solve and its quality measures, measured at 1025 x 1025 points."""
SOLVE_SHARE = 0.8
"""The share of the solve in the whole work, about."""
MEASURED_SHARE = 0.9
"""The share of the whole work that is done when the files are written."""
EXAMPLES = """\
examples:
  equimesh solve '(1-exp(15*(x-1)))*sin(pi*y)' -n 64 -o mesh.vtu
  equimesh solve 'tanh(20*(x-y))' -n 33 --open
  equimesh solve '(1-exp(15*(x-1)))*sin(pi*y)' -n 12 --monitor arc-length \\
      --boundary equidistributed_1d --initial uniform \\
      --subdomains 2x1 --overlap 2 --transmission linear_robin --p 2.3 \\
      --ordering alternating --compare \\
      --plot convergence.png --plot-kind convergence
  equimesh solve 'tanh(20*(x-y))' -n 129 --subdomains 8x1 \\
      --tolerance discretization -o mesh.vtu
  equimesh solve -n 33 -- '-x*y'
  equimesh solve --samples u.csv -n 129 -o mesh.msh --cells triangle
  equimesh solve 'tanh(20*(x-y))' -n 65 --monitor least-error --norm h1 \\
      --smoothness 0.3 -o mesh.vtu
  equimesh solve 'tanh(20*(x-y))' -n 65 --monitor curvature --norm h1 \\
      --domain annulus:1,2,0,90
  equimesh solve --monitor weight --rho '1 + 8*exp(-4*y)' \\
      --domain rectangle:0,3,0,1 --n-xi 97 --n-eta 33
  equimesh solve 'tanh(20*(x-y))' --target-error 1e-4 -o mesh.vtu
  equimesh solve 'tanh(9*(x*x + y*y - 1))' --domain-file bend.json -o mesh.msh

needs the solver: pip install 'equimesh[solver]', and [plot] for --plot and --open

"""
EXITS = {
    Exit.FAILED: "the mesh failed: it did not converge, or it folded",
}


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "solve",
        help="make a mesh here, without a service",
        description="Make the mesh that is adapted to u in this process, and write it to a file.",
        examples=EXAMPLES,
        exits=EXITS,
        usage="equimesh solve [OPTIONS] [U]",
    )
    add_mesh_options(parser)
    parser.add_argument("--threads", metavar="N", type=int, help="threads that share large grids (one for every core)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Solve, write, report."""
    check_options(options)
    load_solver()
    import equimesh as em
    from equimesh_cli.options.problem import build
    from equimesh_cli.report import print_report
    from equimesh_client import Certificate, Convergence, Quality
    from equimesh_coupling.progress_bar import ProgressBar

    n_xi, n_eta = points_of(options)
    _check_memory(em.Grid(n_xi=n_xi, n_eta=n_eta))
    picture = picture_of(options)
    if picture is not None and find_spec("matplotlib") is None:
        raise CommandError("a picture needs matplotlib: pip install 'equimesh[plot]'")
    bar = ProgressBar(False if options.quiet else None, share=SOLVE_SHARE, delay=0.0)
    try:
        with announce_compiling(shown=not options.quiet), bar:
            solution = build(options).solve(threads=options.threads, observe=bar)
            bar.show(SOLVE_SHARE, "measuring the quality")
            quality = solution.quality.summary()
            bar.show(MEASURED_SHARE, "writing the files")
            files = _write(options, solution, picture)
    except em.SolveError as error:
        _report_failure(options, error.solution, picture)
        raise
    certificate, convergence = solution.certificate.summary(), solution.convergence()
    if options.json:
        _print_json(solution, files, certificate=certificate, quality=quality, convergence=convergence)
    elif not options.quiet:
        print_report(Certificate.from_json(certificate), _points_of(solution), solution.message)
        print(Quality.from_json(quality))
        if options.subdomains is not None:
            print(f"\n{Convergence.from_json(convergence)}")
        for file in files:
            print(f"wrote {file}")
    if picture is not None and options.open:
        print(told(picture.path), file=sys.stderr)
    return Exit.DONE


def _report_failure(options: argparse.Namespace, solution: Solution[Any], picture: Picture | None) -> None:
    """Write and report the partial mesh of a failed solve."""
    files = _write(options, solution, picture) if options.partial and not solution.mesh.is_folded else []
    if options.json:
        certificate, convergence = solution.certificate.summary(), solution.convergence()
        _print_json(solution, files, certificate=certificate, convergence=convergence)
    elif not options.quiet:
        if options.subdomains is not None:
            from equimesh_client import Convergence

            print(f"{Convergence.from_json(solution.convergence())}\n")
        for file in files:
            print(f"wrote {file}, a partial mesh")


def _print_json(solution: Solution[Any], files: list[str], **parts: Any) -> None:
    report = {"status": solution.status.value, "message": solution.message, **parts, "files": files}
    print(json.dumps(report, indent=2))


def _points_of(solution: Solution[Any]) -> str:
    """The points of a mesh: in both directions, or of blocks in all."""
    grid = getattr(solution.problem, "grid", None)
    return str(solution.mesh.x.size if grid is None else grid)


def _check_memory(grid: equimesh.Grid) -> None:
    """Raise :class:`CommandError` for a mesh that needs more memory than this machine has."""
    needed, present = BYTES_PER_POINT * grid.points, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > present:
        raise CommandError(
            f"{grid} points need about {needed / 1e9:.0f} GB of memory, and this machine has {present / 1e9:.0f} GB: "
            "take fewer points"
        )


def _write(options: argparse.Namespace, solution: Solution[Any], picture: Picture | None) -> list[str]:
    """Write the requested files and return their names."""
    files = []
    if options.output is not None:
        solution.write(options.output, cells=options.cells, order=options.order)
        files.append(str(options.output))
    if picture is not None:
        from equimesh.plot import convergence, meshes

        match picture.kind:
            case "convergence":
                convergence.draw_convergence(solution.convergence(), picture.path)
            case "comparison":
                meshes.draw_comparison(solution.against_uniform, picture.path)
            case "quality":
                meshes.draw_quality(solution.data(), picture.path)
            case _:
                meshes.draw_mesh(solution.data(), picture.path, decomposition=solution.decomposition)
        files.append(str(picture.path))
    return files
