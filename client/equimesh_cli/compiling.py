"""Loads the solver, and reports when a solve waits for the compiler."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from equimesh_cli.exits import NotInstalled

THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Read by the linear algebra when it is loaded. Its systems are many and small: more threads make it slower."""


def load_solver() -> None:
    """Import the solver, with linear algebra on one thread; raises :class:`NotInstalled` where it is missing."""
    for name in THREAD_COUNTS:
        os.environ.setdefault(name, "1")
    try:
        import scipy  # noqa: F401  # of the extra "solver"

        import equimesh  # noqa: F401
    except ImportError as error:
        raise NotInstalled("solver", error) from error


@contextmanager
def announce_compiling(*, shown: bool = True) -> Iterator[None]:
    """Report on standard error when a loop is compiled inside; with ``shown`` False print nothing."""
    from equimesh.compiling import Line, announcing

    with announcing(Line(plain=True) if shown else None):
        yield
