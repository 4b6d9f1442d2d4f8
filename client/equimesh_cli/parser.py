"""Parsers of the command line, whose errors are sentences."""

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from equimesh_cli.exits import EPILOG, Exit


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence that refers to --help, without a list of all options.

    ``lacks`` is the reason why the parser does not know its options, if so; it then replaces every error message.
    """

    lacks = ""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **arguments)

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As :mod:`argparse` does, but an unknown argument is an error of this parser, which knows its own command."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options, unknown

    def error(self, message: str) -> NoReturn:
        """Print the message, and end with the exit code of bad usage."""
        self.exit(Exit.INPUT, f"equimesh: {self.lacks or f'{message}; see {self.prog} --help'}\n")


def add_command(commands: Any, name: str, *, help: str, description: str, examples: str) -> Parser:
    """The parser of a new command, with its examples and the exit codes under its options."""
    parser: Parser = commands.add_parser(name, help=help, description=description, epilog=examples + EPILOG)
    return parser
