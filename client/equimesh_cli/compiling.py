"""Loads the solver, and reports when a solve waits for the compiler, once per machine."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from equimesh_cli.exits import NotInstalled

THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Read by the linear algebra when it is loaded. Its systems are many and small: more threads make it slower."""
SENTENCE = "compiling kernels, once per machine ..."


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
    """Print a sentence on standard error when a kernel is compiled inside; with ``shown`` False print nothing."""
    from numba.core import event

    class Listener(event.Listener):
        announced = not shown

        def on_start(self, _: Any) -> None:
            if not self.announced:
                self.announced = True
                print(SENTENCE, file=sys.stderr, flush=True)

        def on_end(self, _: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
