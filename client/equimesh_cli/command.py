"""The command line: its parser, and the exit code of an error."""

import os
import sys
from collections.abc import Sequence
from importlib.metadata import version

from equimesh_cli.commands import bench, check, config, database, demo, doctor, generate, keys, serve, solve, worker
from equimesh_cli.exits import EPILOG, Exit, code_of
from equimesh_cli.parser import Parser

EXAMPLES = """\
examples:
  equimesh demo                                           see it work, from nothing to files
  equimesh serve --port 8000                              run a service
  equimesh worker --scheduler tcp://host:8786             a worker of a cluster, for a service
  equimesh keys create --name ada --scope write           an API key for it
  equimesh doctor                                         check this installation
  equimesh generate 'tanh(20*(x-y))' -n 65 -o mesh.vtu    a mesh from a service
  equimesh solve 'tanh(20*(x-y))' -n 65 -o mesh.vtu       a mesh without a service
  equimesh check 'sin(pi*x'                               the faults of an expression
  equimesh bench --quick                                  the cost of a mesh on this machine

`equimesh COMMAND --help` shows the options of a command.

"""


def build_parser(command: str = "") -> Parser:
    """The parser of the command and all its subcommands.

    The options of `serve`, `config` and `doctor` are the settings of the service, which is imported only when
    ``command`` is one of these three.
    """
    parser = Parser(
        prog="equimesh",
        description="Adaptive 2D meshes for PDE solvers, by equidistribution, with a service or without.",
        epilog=EXAMPLES + EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"equimesh {version('equimesh')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    demo.add_parser(commands)
    for part in (serve, config, doctor):
        part.add_parser(commands, full=part.__name__.endswith(f".{command}"))
    for module in (worker, keys, database, generate, solve, check, bench):
        module.add_parser(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code. Errors are sentences on standard error."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        options = build_parser(words[0] if words else "").parse_args(words)
        code: int = options.run(options)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print("\nequimesh: interrupted", file=sys.stderr)
        return Exit.INTERRUPTED
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
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__
