"""Options for the monitor and the domain of a mesh."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from equimesh_cli.exits import Refused
from equimesh_cli.options.fields import add_field, dashed, flag, foreign_to, given_of
from equimesh_schema.document import types_of
from equimesh_schema.domains import AnnulusSector, MeshFile, Rectangle
from equimesh_schema.monitors import MONITORS, REQUIRED_FUNCTIONS, AnyMonitor, Intersection

if TYPE_CHECKING:
    from equimesh_client.spec.domains import Domain

PERIODIC: dict[str, Literal["x", "y", "both"] | None] = {"": None, "x": "x", "y": "y", "both": "both"}
"""The directions in which a rectangle repeats itself, by the word after its numbers."""
SUFFIXES = (".npz", ".npy", ".csv", ".txt", ".json", ".vtu", ".vtk")


KINDS = {dashed(kind): made for kind, made in MONITORS.documents.items() if made is not Intersection}
ALLOWED = {kind: tuple(name for name in types_of(made) if name not in ("kind", "u")) for kind, made in KINDS.items()}
NEEDED = {dashed(kind): names for kind, names in REQUIRED_FUNCTIONS.items() if names and "u" not in names}


def add_monitor_options(parser: argparse.ArgumentParser) -> None:
    """Add the monitor and its settings, which are the fields of all monitors."""
    group = parser.add_argument_group(
        "monitor", "R, M11, M12 and M22 are expressions, with the values of --parameter and --t, or files of samples"
    )
    usual = dashed(str(MONITORS.default))
    group.add_argument("--monitor", type=dashed, choices=tuple(KINDS), default=usual, help=f"({usual})")
    for name in dict.fromkeys(name for names in ALLOWED.values() for name in names):
        kinds = [kind for kind, names in ALLOWED.items() if name in names]
        owners = "" if len(kinds) == len(KINDS) else f"{', '.join(kinds)}: "
        add_field(group, KINDS[kinds[0]], name, owners=owners, spelled=dashed)


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
    foreign = foreign_to(kind, given_of(options, every), ALLOWED, "--monitor")
    if foreign:
        raise Refused(foreign)
    missing = [flag(name) for name in needed if getattr(options, name) is None]
    if missing:
        raise Refused(f"--monitor {kind} needs {', '.join(missing)}")
    texts = [options.u, *(getattr(options, name) for name in needed)]
    formulas = [text for text in texts if text is not None and not isinstance(function(text), Path)]
    if not formulas and (options.parameter or options.t is not None):
        raise Refused("--parameter and --t belong to an expression, not to --samples")


def function(text: str) -> str | Path:
    """A function given on the command line: an expression, or a file of samples by its name."""
    return Path(text) if text.lower().endswith(SUFFIXES) else text


def monitor_of(options: argparse.Namespace) -> AnyMonitor:
    """The monitor of the client, without its u."""
    settings = given_of(options, ALLOWED[options.monitor])
    for name in NEEDED.get(options.monitor, ()):
        settings[name] = function(settings[name])
    if "purpose" in settings:
        settings["purpose"] = settings["purpose"].replace("-", "_")
    monitor: AnyMonitor = KINDS[options.monitor](**settings)
    return monitor


def domain(text: str) -> Domain:
    """The domain that ``text`` names: ``rectangle:0,2,0,1``, ``annulus:1,2,0,90`` or ``@file.json``.

    A fifth word closes lines: ``rectangle:0,2,0,1,x`` (or ``y``, ``both``) and ``annulus:1,2,0,360,closed``.
    """
    from equimesh_client import BadArgument
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
    from equimesh_client import BadArgument, Blocks

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
