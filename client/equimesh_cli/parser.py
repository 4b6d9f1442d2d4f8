"""The parser of the command line, and how commands end: exit codes and refusals."""

from __future__ import annotations

import argparse
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from enum import IntEnum
from typing import Any, NoReturn

# Exit codes, and the table from exceptions to them.


class Exit(IntEnum):
    """The exit codes of commands."""

    DONE = 0
    FAILED = 1
    INPUT = 2
    UNREACHABLE = 3
    DEADLINE = 4
    INTERRUPTED = 130


ALWAYS = {Exit.DONE: "done", Exit.INPUT: "bad usage or bad input", Exit.INTERRUPTED: "interrupted"}
"""The exit codes that every command has, where it does not say more."""
GENERAL = {
    **ALWAYS,
    Exit.FAILED: "what was requested failed: the mesh, or a check of `doctor`",
    Exit.UNREACHABLE: "no service or database answers, or it failed",
    Exit.DEADLINE: "the deadline passed",
}
"""The exit codes of all commands."""


def table_of_exits(meanings: Mapping[Exit, str]) -> str:
    """The end of a help: the exit codes of a command, those that every command has and its own."""
    rows = {**ALWAYS, **meanings}
    return "exit codes:\n" + "".join(f"  {code:<5d}{rows[code]}\n" for code in sorted(rows))


class CommandError(Exception):
    """A command cannot go on; the message is for the user, and ``code`` the exit code."""

    def __init__(self, message: str, code: Exit = Exit.INPUT) -> None:
        super().__init__(message)
        self.code = code


class NotInstalled(CommandError):
    """A part of the package that a command needs is missing: the "service" or the "solver"."""

    def __init__(self, part: str, error: ImportError) -> None:
        super().__init__(f"the {part} is not installed ({error.name}): pip install 'equimesh[{part}]'")


def code_of(error: Exception) -> Exit | None:
    """The exit code for an exception that is meant for the user; None for an error in the program.

    Only loaded packages are examined: another cannot have raised the exception.
    """
    if isinstance(error, CommandError):
        return error.code
    if isinstance(error, OSError) and not isinstance(error, ConnectionError | TimeoutError):
        return Exit.INPUT
    if "equimesh_service" in sys.modules:
        from equimesh_service.errors import CannotServeError

        if isinstance(error, CannotServeError):
            return Exit.INPUT
    if "equimesh_client" in sys.modules:
        from equimesh_client import errors as client

        for kind, code in (
            ((client.MeshFailed, client.MeshCanceled), Exit.FAILED),
            (client.DeadlineExceeded, Exit.DEADLINE),
            ((client.ServiceUnreachable, client.ServerError, client.RateLimited), Exit.UNREACHABLE),
            (client.DownloadDamaged, Exit.UNREACHABLE),
        ):
            if isinstance(error, kind):
                return code
    if "equimesh" in sys.modules:
        import equimesh as solver

        if isinstance(error, solver.SolveError):
            return Exit.FAILED
    if "equimesh_coupling" in sys.modules:
        from equimesh_coupling import EquimeshError

        if isinstance(error, EquimeshError):
            return Exit.INPUT
    return None


# What is expected of the values of options, by their types.
_MEANT = {"--mesh": "--domain-file", "--file": "--samples"}
"""Options that are looked for under other names."""
_NUMBERS: dict[object, str] = {int: "a whole number", float: "a number"}
# Commands of earlier releases, and what does their work now.
_MOVED = {"bench": "`python benchmarks/bench.py` in the source of equimesh measures what a mesh costs"}


class _Form(argparse.HelpFormatter):
    """Fills the paragraphs of a help to the width of the terminal, but not those that are lists under a title."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = text.strip().split("\n\n")
        return "\n\n".join(
            paragraph
            if ":\n  " in paragraph
            else textwrap.fill(paragraph, width, initial_indent=indent, subsequent_indent=indent)
            for paragraph in paragraphs
        )


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence that refers to --help, without a list of all options.

    ``lacks`` is the reason why the parser does not know its options, if so; it then replaces every error message.
    """

    lacks = ""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_Form, **arguments)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """The arguments, as :mod:`argparse` reads them; an unknown one is an error of this parser."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._advice(unknown[0])}")
        return options, unknown

    def _advice(self, unknown: str) -> str:
        """What an unknown argument may be meant for, after a semicolon; empty where nobody can tell."""
        word = unknown.partition("=")[0]
        nearest = get_close_matches(_MEANT.get(word, word), self._option_string_actions, n=1)
        if unknown.startswith("--") and nearest:
            return f"; perhaps {nearest[0]} is meant"
        if all(action.dest != "u" for action in self._actions):
            return ""
        if unknown.startswith("-") and not unknown.startswith("--"):
            return "; an expression that begins with - comes last, after --, as in -- '-x*y'"
        if unknown.isdecimal() and "-n" in self._option_string_actions:
            return f"; the number of points a side is an option: -n {unknown}"
        return "; put the expression in quotes, as in 'tanh(20*(x - y))', or the shell takes it apart"

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a word that is none of the choices, with the nearest of them."""
        if action.choices is None or value in action.choices:
            return
        words = [str(word) for word in action.choices]
        if action.dest == "command" and value in _MOVED:
            raise argparse.ArgumentError(action, f"{value!r} is no command any more; {_MOVED[value]}")
        nearest = get_close_matches(str(value), words, n=1)
        what = "no command" if action.dest == "command" else "no action" if action.dest == "action" else "not known"
        advice = f"perhaps {nearest[0]} is meant" if nearest else f"choose from {', '.join(words)}"
        raise argparse.ArgumentError(action, f"{value!r} is {what}; {advice}")

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """The value of a text; what is no number is refused in words."""
        try:
            return super()._get_value(action, arg_string)
        except argparse.ArgumentError:
            if action.type not in _NUMBERS:
                raise
            sides = re.fullmatch(r"(\d+)[x,](\d+)", arg_string) if action.dest == "n_xi" else None
            advice = f": give --n-xi {sides[1]} --n-eta {sides[2]}" if sides else ""
            raise argparse.ArgumentError(action, f"{arg_string!r} is not {_NUMBERS[action.type]}{advice}") from None

    def error(self, message: str) -> NoReturn:
        """Print the message, and end with the exit code of bad usage."""
        self.exit(Exit.INPUT, f"equimesh: {self.lacks or f'{message}; see {self.prog} --help'}\n")


class GroupedParser(Parser):
    """A parser whose help lists its commands in ``groups``: the titles, and the names of the commands under each."""

    def __init__(self, *, groups: Mapping[str, Sequence[str]], **arguments: Any) -> None:
        super().__init__(**arguments)
        self._groups = groups

    def format_help(self) -> str:
        """The help: its usage, the groups of commands, the other options, and the epilog."""
        below = [action for action in self._actions if isinstance(action, argparse._SubParsersAction)]
        commands = {each.dest: each for action in below for each in action._get_subactions()}
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for title, names in self._groups.items():
            formatter.start_section(title)
            formatter.add_arguments([commands[name] for name in names])
            formatter.end_section()
        formatter.start_section("options")
        formatter.add_arguments([action for action in self._actions if action not in below])
        formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()


NO_EXITS: Mapping[Exit, str] = {}
"""The exit codes of a command that has none of its own."""


def add_command(
    commands: Any,
    name: str,
    *,
    help: str,
    description: str,
    examples: str,
    exits: Mapping[Exit, str] = NO_EXITS,
    usage: str | None = None,
) -> Parser:
    """The parser of a new command, with its examples and its exit codes under its options.

    ``usage`` is for commands with so many options that a list of them would hide the rest.
    """
    parser: Parser = commands.add_parser(
        name, help=help, description=description, epilog=examples + table_of_exits(exits), usage=usage
    )
    return parser


def add_action(actions: Any, name: str, *, help: str, exits: Mapping[Exit, str] = NO_EXITS) -> Parser:
    """The parser of an action of a command, with its exit codes under its options."""
    description = f"{help[0].upper()}{help[1:]}."
    parser: Parser = actions.add_parser(name, help=help, description=description, epilog=table_of_exits(exits))
    return parser
