"""Options for a mesh, which `generate` and `solve` share."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from equimesh_cli.options.monitors import (
    add_field,
    add_monitor_options,
    check_monitor,
    domain,
    domain_file,
    flag,
    foreign_to,
    given_of,
)
from equimesh_cli.parser import CommandError
from equimesh_schema.document import types_of
from equimesh_schema.mesh import SUFFIXES, Grid, MeshSpec, Target
from equimesh_schema.schwarz import TRANSMISSIONS, Schwarz

CONDITIONS = {
    kind: tuple(name for name in types_of(made) if name != "kind") for kind, made in TRANSMISSIONS.documents.items()
}
OF_CONDITIONS = tuple(dict.fromkeys(name for names in CONDITIONS.values() for name in names))
SETTINGS = tuple(name for name in types_of(Schwarz) if name not in ("subdomains", "transmission"))
MESH_SUFFIXES = tuple(SUFFIXES)
SECOND_ORDER = (".vtu", ".hdf", ".msh", ".inp", ".ism", ".re2", ".specfem.zip")
PART_SUFFIXES = (".pvtu", ".vtkhdf")
PLOT_SUFFIXES = (".png", ".svg")
LEAST_POINTS = 25
PLOT_KINDS = ("mesh", "quality", "convergence", "comparison")


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Add the values of names in an expression."""
    parser.add_argument(
        "--parameter",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        type=parameter,
        help="value of a further name in the expression; may be repeated",
    )
    parser.add_argument("--t", type=float, help="value of the name t in the expression")


def add_mesh_options(parser: argparse.ArgumentParser) -> None:
    """Add u, grid, monitor, boundary and Schwarz options, and where results go."""
    parser.add_argument(
        "u", metavar="U", nargs="?", help="u(x, y), e.g. 'tanh(20*(x-y))'; after -- if it begins with -"
    )
    parser.add_argument(
        "--samples",
        metavar="FILE",
        type=Path,
        help="samples of u instead of U: npz, npy, csv, txt, json, vtu or vtk; for solve also zarr or h5",
    )
    parser.add_argument(
        "--column",
        metavar="NAME",
        help="which column of the samples is u, by its name; without a header its number, or matrix",
    )
    add_parameters(parser)
    add_monitor_options(parser)
    mesh = parser.add_argument_group("mesh")
    mesh.add_argument("-n", "--n-xi", dest="n_xi", type=int, help=f"points a side, along xi ({Grid.n_xi})")
    mesh.add_argument("--n-eta", type=int, help="points along eta (as along xi)")
    add_field(mesh, Grid, "points", option="--points")
    add_field(mesh, Target, "error", option="--target-error")
    add_field(mesh, Target, "norm", option="--target-norm")
    domains = mesh.add_mutually_exclusive_group()
    domains.add_argument(
        "--domain",
        metavar="DOMAIN",
        type=domain,
        help="rectangle:X0,X1,Y0,Y1, annulus:R0,R1,ANGLE0,ANGLE1 (degrees), or @FILE with any domain as JSON; closed "
        "lines: rectangle:X0,X1,Y0,Y1,x (or y, both), annulus:R0,R1,0,360,closed "
        "(the unit square)",
    )
    domains.add_argument(
        "--domain-file",
        metavar="FILE",
        dest="domain",
        type=domain_file,
        help="a mesh of quadrilaterals that is the domain (.msh, .vtu, .su2, ...), or blocks as .json; not with -n",
    )
    for name in ("boundary", "initial", "mode", "cells"):
        add_field(mesh, MeshSpec, name, has_default=True)
    mesh.add_argument("--no-relax", action="store_true", help="fail rather than adapt less than requested")
    mesh.add_argument(
        "--partial", action="store_true", help="write the mesh of a failed solve, too, if it is not folded"
    )
    _add_schwarz_options(parser)
    results = parser.add_argument_group("results")
    results.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help=f"the mesh: {' '.join(SUFFIXES)}, or a case of OpenFOAM"
    )
    results.add_argument(
        "--order",
        type=int,
        choices=(1, 2),
        default=1,
        help=f"order of the cells in the file: 2 has nodes in the middle of edges, on curved sides on the curve, for"
        f" {' '.join(SECOND_ORDER)} (1)",
    )
    results.add_argument("--plot", metavar="FILE", type=Path, help="draw a picture: .png or .svg")
    results.add_argument(
        "--plot-kind", choices=PLOT_KINDS, help="what it shows (mesh; with --open and a u: comparison)"
    )
    results.add_argument(
        "--open", action="store_true", help="open the picture, drawn for a look at it if there is no --plot"
    )
    results.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    results.add_argument("--quiet", action="store_true", help="no line of progress, no tables")


def _add_schwarz_options(parser: argparse.ArgumentParser) -> None:
    schwarz = parser.add_argument_group("Schwarz iteration", "without --subdomains there is a single domain")
    schwarz.add_argument(
        "--subdomains",
        metavar="AxB",
        type=_subdomains,
        help="along xi and eta, e.g. 2x1; or the grid lines at which they meet, each with a comma: 24,40,x1",
    )
    usual = Schwarz.transmission.kind
    schwarz.add_argument("--transmission", choices=tuple(CONDITIONS), help=f"condition at the interfaces ({usual})")
    for name in SETTINGS:
        add_field(schwarz, Schwarz, name)
    for name in OF_CONDITIONS:
        kinds = [kind for kind, names in CONDITIONS.items() if name in names]
        add_field(schwarz, TRANSMISSIONS.documents[kinds[0]], name, owners=f"{', '.join(kinds)}: ")


def check_options(options: argparse.Namespace, *, suffixes: Sequence[str] = MESH_SUFFIXES) -> None:
    """Raises :class:`CommandError` for options that contradict each other, before any work is done.

    ``suffixes`` are those of the file of the mesh.
    """
    check_monitor(options)
    _check_target(options)
    _check_points(options)
    _check_cells(options)
    _check_picture(options)
    _check_schwarz(options)
    for path, allowed in ((options.output, tuple(suffixes)), (options.plot, PLOT_SUFFIXES)):
        if path is None or (path is options.output and path.is_dir()):
            continue
        if not str(path).lower().endswith(allowed):
            case = ", or name the folder of an OpenFOAM case, which must exist" if path is options.output else ""
            raise CommandError(f"{path}: the suffix must be one of {' '.join(allowed)}{case}")
        if not path.parent.is_dir():
            raise CommandError(
                f"{path.parent}: there is no such folder; make it first: mkdir -p {quote(str(path.parent))}"
            )


def _check_schwarz(options: argparse.Namespace) -> None:
    """Refuse settings of an iteration that there is not, or of another condition."""
    given = given_of(options, ("transmission", *SETTINGS, *OF_CONDITIONS))
    if given and options.subdomains is None:
        flags = [f"--no-{flag(name).lstrip('-')}" if value is False else flag(name) for name, value in given.items()]
        raise CommandError(f"{', '.join(flags)} is for the Schwarz iteration; add --subdomains, e.g. --subdomains 2x1")
    foreign = foreign_to(options.transmission or Schwarz.transmission.kind, given, CONDITIONS, "--transmission")
    if foreign:
        raise CommandError(foreign)


def _check_picture(options: argparse.Namespace) -> None:
    """Refuse a picture of an iteration that there is not."""
    has_steps = options.subdomains is not None or options.monitor in ("auto", "least-error")
    if options.plot_kind == "convergence" and not has_steps:
        raise CommandError(
            "--plot-kind convergence draws a Schwarz iteration or a descent, and this is neither: add --subdomains,"
            " e.g. --subdomains 2x1, or take another kind of picture"
        )
    if options.plot_kind is not None and options.plot is None and not options.open:
        raise CommandError(f"--plot-kind {options.plot_kind} needs a picture: add --plot FILE, or --open")


def _check_cells(options: argparse.Namespace) -> None:
    if options.cells == "triangle" and str(options.output or "").lower().endswith(".vts"):
        raise CommandError("a .vts file holds no triangles: choose another format, or leave out --cells")
    if options.order == 2 and not str(options.output or "").lower().endswith(SECOND_ORDER):
        raise CommandError(
            f"--order 2 is for a file of {', '.join(SECOND_ORDER)}: name one by -o, or leave out --order"
        )


def _check_points(options: argparse.Namespace) -> None:
    """Refuse too few points for a grid, and a grid for a domain that has points of its own: it takes their number."""
    from equimesh_client.spec.domains import has_own_points

    given = (options.n_xi, options.n_eta, options.target_error)
    if not has_own_points(options.domain):
        if options.points is not None and options.points < LEAST_POINTS:
            raise CommandError(f"--points {options.points}: give at least {LEAST_POINTS}, 5 points a direction")
    elif any(one is not None for one in given):
        raise CommandError(
            "the mesh of the domain has points of its own: leave out -n, --n-eta and --target-error; --points, those of"
            " the whole mesh, chooses the cells of its blocks"
        )


def _check_target(options: argparse.Namespace) -> None:
    has_n = options.n_xi is not None or options.n_eta is not None
    if options.points is not None:
        if has_n or options.target_error is not None:
            raise CommandError("--points takes the place of -n, --n-eta and --target-error: give one of them")
    elif options.target_error is None:
        if options.target_norm is not None:
            raise CommandError("--target-norm is the norm of a target; add --target-error, e.g. --target-error 1e-4")
    elif has_n:
        raise CommandError("--target-error takes the place of -n and --n-eta: give one of them")


@dataclass(frozen=True)
class Picture:
    """A requested picture: its file and what it shows."""

    path: Path
    kind: str


def picture_of(options: argparse.Namespace) -> Picture | None:
    """The requested picture; with --open alone it is in a new folder for temporary files."""
    if options.plot is None and not options.open:
        return None
    has_u = options.u is not None or options.samples is not None
    kind = options.plot_kind or ("comparison" if options.open and has_u else "mesh")
    path = options.plot or Path(tempfile.mkdtemp(prefix="equimesh-")) / f"{kind}.png"
    return Picture(path, kind)


def points_of(options: argparse.Namespace) -> tuple[int, int]:
    """Points along xi and eta."""
    n_xi = Grid.n_xi if options.n_xi is None else options.n_xi
    return n_xi, n_xi if options.n_eta is None else options.n_eta


def target_of(options: argparse.Namespace) -> Target | None:
    """The target of the client; None for a grid."""
    norm = options.target_norm or Target.norm
    if options.points is not None:
        return Target(max_points=options.points, norm=norm)
    return None if options.target_error is None else Target(error=options.target_error, norm=norm)


def schwarz_of(options: argparse.Namespace) -> Schwarz | None:
    """The Schwarz settings of the client; None for a single domain."""
    if options.subdomains is None:
        return None
    kind = options.transmission or Schwarz.transmission.kind
    condition = TRANSMISSIONS.documents[kind](**given_of(options, CONDITIONS[kind]))
    return Schwarz(subdomains=options.subdomains, transmission=condition, **given_of(options, SETTINGS))


def _subdomains(text: str) -> tuple[int | tuple[int, ...], int | tuple[int, ...]]:
    try:
        along_xi, along_eta = text.lower().replace("×", "x").split("x")
        return _division(along_xi), _division(along_eta)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not like 2x1, nor like 24,40,x1") from None


def _division(text: str) -> int | tuple[int, ...]:
    """A number of subdomains, or the grid lines at which they meet: with a comma."""
    return tuple(int(line) for line in text.rstrip(",").split(",")) if "," in text else int(text)


def parameter(text: str) -> tuple[str, float]:
    """The name and the value of ``c=2.5``."""
    name, equals, value = text.partition("=")
    try:
        if name and equals:
            return name.strip(), float(value)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is not like c=2.5")
