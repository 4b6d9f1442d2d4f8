"""Options for the monitor and the domain of a mesh."""

from __future__ import annotations

import argparse
import json
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from equimesh_cli.exits import Refused
from equimesh_schema.document import docs_of, one_of, types_of
from equimesh_schema.monitors import MONITORS, REQUIRED_FUNCTIONS, AnyMonitor, Intersection
from equimesh_schema.sources import SOURCES

if TYPE_CHECKING:
    from equimesh_client.spec.domains import Domain

PERIODIC: dict[str, Literal["x", "y", "both"] | None] = {"": None, "x": "x", "y": "y", "both": "both"}
"""The directions in which a rectangle repeats itself, by the word after its numbers."""
SUFFIXES = (".npz", ".npy", ".csv", ".txt", ".json", ".vtu", ".vtk")


def _dashed(word: str) -> str:
    """A word of a spec, such as a kind of monitor, as it is spelled here; ``least_error`` itself is understood, too."""
    return word.replace("_", "-")


KINDS = {_dashed(kind): made for kind, made in MONITORS.documents.items() if made is not Intersection}
ALLOWED = {kind: tuple(name for name in types_of(made) if name not in ("kind", "u")) for kind, made in KINDS.items()}
NEEDED = {_dashed(kind): names for kind, names in REQUIRED_FUNCTIONS.items() if names and "u" not in names}
METAVARS = {"smoothing": "RADIUS", "orthogonality": "DEGREES"}


def add_monitor_options(parser: argparse.ArgumentParser) -> None:
    """Add the monitor and its settings, which are the fields of all monitors."""
    group = parser.add_argument_group(
        "monitor", "R, M11, M12 and M22 are expressions, with the values of --parameter and --t, or files of samples"
    )
    usual = _dashed(str(MONITORS.default))
    group.add_argument("--monitor", type=_dashed, choices=tuple(KINDS), default=usual, help=f"({usual})")
    for name in dict.fromkeys(name for names in ALLOWED.values() for name in names):
        kinds = [kind for kind, names in ALLOWED.items() if name in names]
        made = KINDS[kinds[0]]
        (field,) = (field for field in fields(made) if field.name == name)
        owners = "" if len(kinds) == len(KINDS) else f"{', '.join(kinds)}: "
        help_of = f"{owners}{docs_of(made).get(name, '')}{_default_of(field.default)}".replace("%", "%%")
        group.add_argument(_flag(name), dest=name, default=None, help=help_of, **_reading(field, types_of(made)[name]))


def _default_of(default: object) -> str:
    return "" if default is MISSING or default is None or default is False else f" ({default})"


def _reading(field: Field[Any], annotation: Any) -> dict[str, Any]:
    """How an option is read that is a field of this type."""
    if one_of(annotation) is SOURCES:
        return {"metavar": field.name.upper().removesuffix("HO")}
    annotations = [annotation]
    for one in annotations:
        annotations += get_args(one)
    if bool in annotations:
        return {"action": argparse.BooleanOptionalAction if field.default else "store_true"}
    if float in annotations:
        return {"type": float, "metavar": METAVARS.get(field.name)}
    return {"type": _dashed, "choices": tuple(_dashed(word) for word in annotations if isinstance(word, str))}


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


def monitor_of(options: argparse.Namespace) -> AnyMonitor:
    """The monitor of the client, without its u."""
    values = {name: getattr(options, name) for name in ALLOWED[options.monitor]}
    settings: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
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
