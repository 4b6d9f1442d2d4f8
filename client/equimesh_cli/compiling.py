"""Says when a solve has to wait for the compiler, which it does once per machine."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SENTENCE = "compiling kernels, once per machine ..."


@contextmanager
def announce_compiling(*, shown: bool = True) -> Iterator[None]:
    """Say so on standard error when a kernel is compiled inside, rather than found in numba's cache."""
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
