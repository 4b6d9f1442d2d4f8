"""The command `equimesh`."""

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code, also where Ctrl-C comes while the commands are imported."""
    try:
        from equimesh_cli import command

        return command.main(arguments)
    except KeyboardInterrupt:
        print("\nequimesh: interrupted", file=sys.stderr)
        return 130
