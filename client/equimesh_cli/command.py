"""The command line: its parser, and the exit code of an error."""

import argparse
import errno
import os
import sys
from collections.abc import Sequence
from typing import Any

from equimesh_cli.commands import (
    check,
    completion,
    config,
    database,
    demo,
    doctor,
    generate,
    keys,
    serve,
    solve,
    worker,
)
from equimesh_cli.parser import GENERAL, Exit, GroupedParser, Parser, code_of, table_of_exits

EXAMPLES = """\
examples:
  equimesh demo                                      from nothing to files
  equimesh solve 'tanh(20*(x-y))' -n 65 --open       a mesh, and its picture
  equimesh solve 'tanh(20*(x-y))' -o mesh.vtu        a mesh in a file
  equimesh generate 'tanh(20*(x-y))' -o mesh.vtu     a mesh from a service
  equimesh serve --port 8000                         run a service
  equimesh doctor                                    check this installation
  source <(equimesh completion bash)                 complete with the tab key

`equimesh COMMAND --help` shows the options of a command, and its own exit codes.

"""
GROUPS = {
    "make a mesh": ("solve", "generate", "check"),
    "run a service": ("demo", "serve", "worker"),
    "look after a service": ("doctor", "config", "keys", "database"),
    "on this machine": ("completion",),
}
"""The commands of the help, by what they are for."""
_FULL = {errno.ENOSPC, errno.EDQUOT}
_DECLARE = "declare others as parameters"
_DECLARE_HERE = "give others a value with --parameter, as in --parameter c=2"
# Commands whose options are the settings of the service. The completion knows the options of all commands.
_WITH_SETTINGS = (serve, config, doctor)


def build_parser(command: str = "") -> Parser:
    """The parser of the command and all its subcommands.

    The options of `serve`, `config` and `doctor` are the settings of the service, which is imported only when
    ``command`` is one of these three, or `completion`. Without a command the help is shown.
    """
    parser = GroupedParser(
        prog="equimesh",
        description="Adaptive 2D meshes of quadrilaterals for PDE solvers, with a service or without.",
        epilog=EXAMPLES + table_of_exits(GENERAL),
        groups=GROUPS,
    )
    parser.add_argument("--version", action=_Version, help="print the version")
    parser.set_defaults(run=lambda _: _show_help(parser))
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    for part in _WITH_SETTINGS:
        part.add_parser(commands, full=command == "completion" or part.__name__.endswith(f".{command}"))
    for module in (demo, worker, keys, database, generate, solve, check):
        module.add_parser(commands)
    completion.add_parser(commands, lambda: build_parser("completion"))
    return parser


class _Version(argparse.Action):
    """Prints the version, which is looked up only then."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(nargs=0, **arguments)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print it, and end."""
        from importlib.metadata import version

        print(f"equimesh {version('equimesh')}")
        parser.exit(Exit.DONE)


def _show_help(parser: Parser) -> Exit:
    parser.print_help()
    return Exit.DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code. Errors are sentences on standard error."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        options = build_parser(words[0] if words else "").parse_args(words)
        code: int = options.run(options)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader of the output is gone. Python's own flush at exit must not fail, too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.DONE
    except Exception as error:
        code_or_none = code_of(error)
        if code_or_none is None:
            raise
        print(f"equimesh: {sentence(error)}", file=sys.stderr)
        return code_or_none


def sentence(error: Exception) -> str:
    """The message of an error, without the name of its class."""
    if isinstance(error, OSError) and error.strerror:
        place = "" if error.filename is None else f"{error.filename}: "
        advice = ": make room, or write to another disk" if error.errno in _FULL else ""
        return f"{place}{error.strerror}{advice}"
    # The solver and the service do not know how parameters are declared here.
    return str(error).replace(_DECLARE, _DECLARE_HERE) or type(error).__name__
