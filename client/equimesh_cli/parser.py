"""Parsers of the command's words, which say what is wrong in a sentence."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from equimesh_cli.exits import Exit


class Parser(argparse.ArgumentParser):
    """A parser whose errors are a sentence and where to read on, without all options there are.

    ``lacks`` says why it does not know its options, if it does not; it is the answer to any error then.
    """

    lacks = ""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As of :mod:`argparse`, but what is not known is an error of this parser, which knows its own command."""
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options, unknown

    def error(self, message: str) -> NoReturn:
        """Print the sentence, and end with the exit code of bad usage."""
        self.exit(Exit.INPUT, f"equimesh: {self.lacks or f'{message}; see {self.prog} --help'}\n")
