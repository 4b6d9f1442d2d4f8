"""`equimesh completion`: the script that completes commands, options, words and files in a shell."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from equimesh_cli.parser import Exit, Parser, add_command

SHELLS = ("bash", "zsh", "tcsh")
# Options whose values are names of folders, and those that have names of files without being of that type.
FOLDERS = ("--data-dir",)
FILES = ("--rho", "--m11", "--m12", "--m22")
EXAMPLES = """\
examples:
  equimesh completion bash > ~/.local/share/bash-completion/completions/equimesh
  equimesh completion zsh > ~/.zfunc/_equimesh
  equimesh completion tcsh > ~/.equimesh.tcsh
  source <(equimesh completion bash)             in this bash only

Make the folder first, with mkdir -p. For zsh, fpath+=~/.zfunc stands before compinit in ~/.zshrc. For tcsh,
`source ~/.equimesh.tcsh` stands in ~/.tcshrc. Then open a new shell. Write the script again after an upgrade. The
options of `serve` are in it if the service is installed.

"""


def add_parser(commands: Any, build: Callable[[], Parser]) -> None:
    """Add the command; ``build`` makes the parser of the whole command line, with all options."""
    parser = add_command(
        commands,
        "completion",
        help="print the completion for a shell",
        description="Print the script with which a shell completes commands, options, their words, and files.",
        examples=EXAMPLES,
    )
    parser.add_argument("shell", choices=SHELLS, help="the shell")
    parser.set_defaults(run=lambda options: run(options, build()))


def run(options: argparse.Namespace, parser: Parser) -> int:
    """Print the script."""
    print(script(parser, options.shell))
    return Exit.DONE


def script(parser: Parser, shell: str) -> str:
    """The completion of a command line in one of the shells."""
    import shtab

    for action in _actions(parser):
        action.choices = action.choices or getattr(action, "words", None)
        if is_folder(action):
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif is_file(action):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    return shtab.complete(parser, shell)


def is_folder(action: argparse.Action) -> bool:
    """Whether the value of an option is a folder."""
    return action.metavar == "DIR" or any(flag in FOLDERS for flag in action.option_strings)


def is_file(action: argparse.Action) -> bool:
    """Whether the value of an option is a file, or may be one."""
    return action.type is Path or any(flag in FILES for flag in action.option_strings)


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """The options of a parser and of all commands below it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)
        else:
            yield action
