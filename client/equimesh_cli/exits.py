"""Exit codes, and the table from exceptions to them."""

import sys
from enum import IntEnum

EPILOG = """\
exit codes:
  0    done
  1    the mesh failed: it did not converge, it folded, or it was canceled; doctor: a check failed
  2    bad usage or bad input
  3    no service answers, or it failed
  4    the deadline passed
  130  interrupted
"""


class Exit(IntEnum):
    """The exit codes of commands."""

    DONE = 0
    FAILED = 1
    INPUT = 2
    UNREACHABLE = 3
    DEADLINE = 4
    INTERRUPTED = 130


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
