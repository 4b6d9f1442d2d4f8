"""The command `equimesh`."""

from equimesh_cli.command import main

__all__ = ["main"]
