"""Exit codes, and the table from exceptions to them."""

import sys
from collections.abc import Mapping
from enum import IntEnum


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


class Refused(Exception):
    """Usage or input that a command cannot use; the message is for the user."""

    def __init__(self, message: str, code: Exit = Exit.INPUT) -> None:
        super().__init__(message)
        self.code = code


class NotInstalled(Refused):
    """A part of the package that a command needs is missing: the "service" or the "solver"."""

    def __init__(self, part: str, error: ImportError) -> None:
        super().__init__(f"the {part} is not installed ({error.name}): pip install 'equimesh[{part}]'")


def code_of(error: Exception) -> Exit | None:
    """The exit code for an exception that is meant for the user; None for an error in the program.

    Only loaded packages are examined: another cannot have raised the exception.
    """
    if isinstance(error, Refused):
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
