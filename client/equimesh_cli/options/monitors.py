"""Options for the monitor and the domain of a mesh."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from equimesh_cli.exits import Refused

if TYPE_CHECKING:
    from equimesh_client.spec.domains import Domain
    from equimesh_client.spec.monitors import Monitor

NEEDED = {"weight": ("rho",), "tensor": ("m11", "m12", "m22")}
ALLOWED = {
    "auto": ("norm", "purpose", "orthogonality"),
    "least-error": ("norm", "distortion", "smoothness", "rectilinear", "orthogonality"),
    "nodal-solution": ("norm", "orthogonality"),
    "arc-length": ("a", "b", "scaled", "smoothing", "orthogonality"),
    "curvature": ("norm", "isotropic", "smoothing", "orthogonality"),
    "weight": ("rho", "map", "smoothing", "orthogonality"),
    "tensor": ("m11", "m12", "m22", "smoothing", "orthogonality"),
}
PERIODIC: dict[str, Literal["x", "y", "both"] | None] = {"": None, "x": "x", "y": "y", "both": "both"}
"""The directions in which a rectangle repeats itself, by the word after its numbers."""
SUFFIXES = (".npz", ".npy", ".csv", ".txt", ".json", ".vtu", ".vtk", ".xdmf", ".zip")


def _dashed(word: str) -> str:
    """A kind of monitor as it is spelled here; ``least_error`` of a spec is understood, too."""
    return word.replace("_", "-")


def add_monitor_options(parser: argparse.ArgumentParser) -> None:
    """Add the monitor and its settings."""
    group = parser.add_argument_group(
        "monitor", "R, M11, M12 and M22 are expressions, with the values of --parameter and --t, or files of samples"
    )
    group.add_argument("--monitor", type=_dashed, choices=tuple(ALLOWED), default="auto", help="(auto)")
    group.add_argument(
        "--norm",
        choices=("l2", "h1"),
        help="auto, least-error, nodal-solution, curvature: the error to keep small (l2)",
    )
    group.add_argument(
        "--for",
        dest="purpose",
        type=_dashed,
        choices=("finite-volume",),
        help="auto: choose by the error of a code with cell-centred unknowns",
    )
    group.add_argument(
        "--distortion",
        type=float,
        help="least-error: weight of deformed cells, less for a smaller error (0.5)",
    )
    group.add_argument(
        "--smoothness", type=float, help="least-error: weight of uneven neighbours, less for a smaller error (1.0)"
    )
    group.add_argument(
        "--rectilinear", action="store_true", default=None, help="least-error: x of xi alone, y of eta alone"
    )
    group.add_argument("-a", type=float, help="arc-length: strength of the adaptation, 0 to 1 (0.7)")
    group.add_argument("-b", type=float, help="arc-length: damping where u is steep, not negative (0.05)")
    group.add_argument(
        "--scaled",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="arc-length: u in units of its range, lengths in units of the domain (True: --no-scaled as in the paper)",
    )
    group.add_argument(
        "--isotropic", action="store_true", default=None, help="curvature: small cells, without a preferred direction"
    )
    group.add_argument("--rho", metavar="R", help="weight: the function, positive; U is not needed")
    group.add_argument(
        "--map",
        choices=("lines", "gradient"),
        help="weight: equal lengths along mesh lines, or equal areas times R by a map that is a gradient (lines)",
    )
    for name in ("m11", "m12", "m22"):
        group.add_argument(f"--{name}", metavar=name.upper(), help="tensor: an entry; U is not needed")
    group.add_argument(
        "--smoothing",
        metavar="RADIUS",
        type=float,
        help="not for auto and least-error: average the metric over this part of the domain, at most 0.25 (0)",
    )
    group.add_argument(
        "--orthogonality",
        metavar="DEGREES",
        type=float,
        help="largest angle between the normal of a face and the line of its two cell centres (no bound)",
    )


def check_monitor(options: argparse.Namespace) -> None:
    """Raises :class:`Refused` for options that contradict each other."""
    kind, needed = options.monitor, NEEDED.get(options.monitor, ())
    if options.u is not None and options.samples is not None:
        raise Refused(f"u is given twice, as {options.u!r} and as --samples {options.samples}: leave out one of them")
    if options.column is not None and options.samples is None:
        raise Refused("--column names a column of --samples FILE: give both")
    if options.u is None and options.samples is None and not needed:
        raise Refused("no u is given: write an expression in quotes, such as 'tanh(20*(x - y))', or --samples FILE")
    every = {name for names in ALLOWED.values() for name in names}
    foreign = [name for name in sorted(every) if getattr(options, name) is not None and name not in ALLOWED[kind]]
    if foreign:
        owners = " or ".join(other for other, names in ALLOWED.items() if foreign[0] in names)
        raise Refused(f"{_flag(foreign[0])} is for --monitor {owners}, and this is --monitor {kind}")
    missing = [_flag(name) for name in needed if getattr(options, name) is None]
    if missing:
        raise Refused(f"--monitor {kind} needs {', '.join(missing)}")
    texts = [options.u, *(getattr(options, name) for name in needed)]
    formulas = [text for text in texts if text is not None and not isinstance(function(text), Path)]
    if not formulas and (options.parameter or options.t is not None):
        raise Refused("--parameter and --t belong to an expression, not to --samples")


def function(text: str) -> str | Path:
    """A function given on the command line: an expression, or a file of samples by its name."""
    return Path(text) if text.lower().endswith(SUFFIXES) else text


def monitor_of(options: argparse.Namespace) -> Monitor:
    """The monitor of the client, without its u."""
    from equimesh_client import ArcLength, Auto, Curvature, LeastError, NodalSolution, Tensor, Weight

    values = {name: getattr(options, name) for name in ALLOWED[options.monitor]}
    settings: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
    for name in NEEDED.get(options.monitor, ()):
        settings[name] = function(settings[name])
    if "purpose" in settings:
        settings["purpose"] = settings["purpose"].replace("-", "_")
    kinds: dict[str, Callable[..., Monitor]] = {
        "auto": Auto,
        "least-error": LeastError,
        "nodal-solution": NodalSolution,
        "arc-length": ArcLength,
        "curvature": Curvature,
        "weight": Weight,
        "tensor": Tensor,
    }
    return kinds[options.monitor](**settings)


def domain(text: str) -> Domain:
    """The domain that ``text`` names: ``rectangle:0,2,0,1``, ``annulus:1,2,0,90`` or ``@file.json``.

    A fifth word closes lines: ``rectangle:0,2,0,1,x`` (or ``y``, ``both``) and ``annulus:1,2,0,360,closed``.
    """
    from equimesh_client import AnnulusSector, BadArgument, Rectangle
    from equimesh_client.spec.domains import read_domain

    if text.startswith("@"):
        try:
            return read_domain(json.loads(Path(text[1:]).read_bytes()))
        except OSError as error:
            raise argparse.ArgumentTypeError(f"{text[1:]}: {error.strerror or error}") from None
        except (ValueError, BadArgument) as error:
            raise argparse.ArgumentTypeError(f"{text[1:]} holds no domain: {error}") from None
    kind, _, rest = text.partition(":")
    *numbers, word = rest.split(",") if rest.count(",") == 4 else [*rest.split(","), ""]
    try:
        first, second, third, fourth = (float(part) for part in numbers)
    except ValueError:
        first = second = third = fourth = float("nan")
        kind = ""
    if kind == "rectangle" and word in PERIODIC:
        return Rectangle(x=(first, second), y=(third, fourth), periodic=PERIODIC[word])
    if kind == "annulus" and word in ("", "closed"):
        return AnnulusSector(radii=(first, second), angles=(third, fourth), closed=bool(word))
    if Path(text).exists():
        raise argparse.ArgumentTypeError(f"{text} is a file: give it as --domain-file {text}")
    raise argparse.ArgumentTypeError(
        f"{text!r} is not like rectangle:0,2,0,1, annulus:1,2,0,90 or @domain.json; a fifth word closes lines:"
        " rectangle:0,2,0,1,x (or y, both), annulus:1,2,0,360,closed"
    )


def domain_file(text: str) -> Domain:
    """The domain in a file: a mesh of quadrilaterals, or JSON of any domain, or of blocks without a kind."""
    from equimesh_client import BadArgument, Blocks, MeshFile

    path = Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"{text}: there is no such file")
    if path.suffix.lower() != ".json":
        return MeshFile(file=path)
    try:
        document = json.loads(path.read_bytes())
        if isinstance(document, dict) and document.get("kind", "blocks") != "blocks":
            return domain(f"@{text}")
        return Blocks.of(document, folder=path.parent)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error.strerror or error}") from None
    except (ValueError, BadArgument) as error:
        raise argparse.ArgumentTypeError(f"{text} holds no domain: {error}") from None


def _flag(name: str) -> str:
    return "--for" if name == "purpose" else f"-{name}" if len(name) == 1 else f"--{name}"
