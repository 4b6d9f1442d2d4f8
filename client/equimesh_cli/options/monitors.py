"""Options that are fields of a request; those of the monitor and the domain."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from equimesh_cli.parser import CommandError
from equimesh_schema.document import docs_of, types_of
from equimesh_schema.domains import AnnulusSector, MeshFile, Rectangle
from equimesh_schema.monitors import MONITORS, REQUIRED_FUNCTIONS, AnyMonitor, Intersection
from equimesh_schema.settings import Setting, setting_of

if TYPE_CHECKING:
    from equimesh_client.spec.domains import Domain


# Options that are fields of the documents of a request: how they are spelled, read and described.

FLAGS = {
    "purpose": "for",
    "data": "interface-data",
    "compare_single_domain": "compare",
    "norm of target": "target-norm",
    "error of target": "target-error",
}
"""The options of fields that have another name in Python."""
METAVARS = {"smoothing": "RADIUS", "orthogonality": "DEGREES", "line_correction": "N", "error": "ERROR"}


def dashed(word: str) -> str:
    """A word of a spec, such as a kind of monitor, as it is spelled here; ``least_error`` itself is understood, too."""
    return word.replace("_", "-")


def flag(name: str) -> str:
    """The option of a field."""
    return f"-{name}" if len(name) == 1 and name != "p" else f"--{FLAGS.get(name, dashed(name))}"


def add_field(
    group: argparse._ActionsContainer,
    document: type[Any],
    name: str,
    *,
    option: str = "",
    owners: str = "",
    spelled: Callable[[str], str] = str,
    has_default: bool = False,
) -> None:
    """Add the option of a field: its help is the docstring of the field, and its default.

    What is not given is None, or with ``has_default`` the default. ``owners`` are the kinds that have it, ``spelled``
    spells its words.
    """
    setting = setting_of(document, name)
    (default,) = (one.default for one in fields(document) if one.name == name)
    told = docs_of(document).get(name, "").replace("null", "none")
    group.add_argument(
        option or flag(name),
        dest=(option or name).lstrip("-").replace("-", "_"),
        default=default if has_default else None,
        help=f"{owners}{told}{_shown(default)}".replace("%", "%%"),
        **({"metavar": name.upper().removesuffix("HO")} if setting is None else _reading(name, setting, spelled)),
    )


def _shown(default: object) -> str:
    return "" if default is MISSING or default is None or default is False else f" ({default})"


def _reading(name: str, setting: Setting, spelled: Callable[[str], str]) -> dict[str, Any]:
    """How the option of a setting is read. None is the word ``none``, where it is not the default."""
    words = (*setting.words, "none") if setting.takes_null and setting.default is not None else setting.words
    if setting.plain is None:
        return {"type": spelled, "choices": tuple(map(spelled, words))}
    if setting.plain is bool:
        return {"action": argparse.BooleanOptionalAction if setting.default else "store_true"}
    metavar = {"metavar": METAVARS[name]} if name in METAVARS else {}
    return {"type": number_or(setting.plain, words) if words else setting.plain, **metavar}


def number_or(kind: type[float] | type[int], words: Iterable[str]) -> Callable[[str], float | str]:
    """The reader of a number of this kind, or of one of some words."""
    known = tuple(words)

    def read(text: str) -> float | str:
        if text.lower() in known:
            return text.lower()
        try:
            return kind(text)
        except ValueError:
            noun = "number" if kind is float else "whole number"
            raise argparse.ArgumentTypeError(f"{text!r} is neither a {noun} nor {' nor '.join(known)}") from None

    return read


def given_of(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """The options that are given, by the names of their fields; ``none`` is None."""
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    return {name: None if (name, value) == ("tolerance", "none") else value for name, value in given.items()}


def foreign_to(kind: str, given: Iterable[str], owners: Mapping[str, Iterable[str]], option: str) -> str:
    """The sentence about options that ``kind`` does not have, of those that are ``given``; empty where it has all.

    ``owners`` has the names of the fields of each kind; ``option`` chooses the kind.
    """
    every = {name for names in owners.values() for name in names}
    foreign = [name for name in sorted(given) if name in every and name not in owners[kind]]
    if not foreign:
        return ""
    others = " or ".join(other for other, names in owners.items() if foreign[0] in names)
    return f"{flag(foreign[0])} is for {option} {others}, and this is {option} {kind}"


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
    """Raises :class:`CommandError` for options that contradict each other."""
    kind, needed = options.monitor, NEEDED.get(options.monitor, ())
    if options.u is not None and options.samples is not None:
        raise CommandError(
            f"u is given twice, as {options.u!r} and as --samples {options.samples}: leave out one of them"
        )
    if options.column is not None and options.samples is None:
        raise CommandError("--column names a column of --samples FILE: give both")
    if options.u is None and options.samples is None and not needed:
        raise CommandError(
            "no u is given: write an expression in quotes, such as 'tanh(20*(x - y))', or --samples FILE"
        )
    every = {name for names in ALLOWED.values() for name in names}
    foreign = foreign_to(kind, given_of(options, every), ALLOWED, "--monitor")
    if foreign:
        raise CommandError(foreign)
    missing = [flag(name) for name in needed if getattr(options, name) is None]
    if missing:
        raise CommandError(f"--monitor {kind} needs {', '.join(missing)}")
    texts = [options.u, *(getattr(options, name) for name in needed)]
    formulas = [text for text in texts if text is not None and not isinstance(function(text), Path)]
    if not formulas and (options.parameter or options.t is not None):
        raise CommandError("--parameter and --t belong to an expression, not to --samples")


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
