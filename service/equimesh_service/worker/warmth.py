"""The warm-up of a process, once: of a worker, or of the process that all workers are forked from."""

import logging
from contextlib import suppress
from typing import Any

from numba.core import event

from equimesh.numerics.compiled import count_compiled, load_kept
from equimesh.warm_up import warm_up, warm_up_basics
from equimesh_service.errors import NotCompiledError

_log = logging.getLogger(__name__)
# Whether this process is warm for the basic kinds, and whether it has all loops.
_has_basics = _is_warm = False


class _Refusal(event.Listener):
    """Ends a warm-up that would compile."""

    def on_start(self, _: Any) -> None:
        raise NotCompiledError

    def on_end(self, _: Any) -> None:
        pass


def warm_up_once() -> None:
    """Warm this process up, unless it is warm, or was forked from one that is."""
    global _is_warm
    if not _is_warm:
        warm_up()
        _is_warm = True


def warm_up_for_basics() -> None:
    """Warm this process up for the most frequent kinds of problems, unless it is, or was forked from such one."""
    global _has_basics
    if not (_has_basics or _is_warm):
        warm_up_basics()
        _has_basics = True


def progress() -> dict[str, int]:
    """The number of compiled loops, and the number of all; both 0 once all are compiled. Any process compiles them."""
    compiled, of = count_compiled()
    return {"compiled": compiled, "of": of} if compiled < of else {"compiled": 0, "of": 0}


def warm_up_unless_compiling() -> None:
    """Warm this process up for the basic kinds, and load all other loops, where that compiles none; never raises.

    To compile them takes long, and the process that workers are forked from starts no worker meanwhile, also none that
    a stopping service waits for. The first worker compiles them then.
    """
    global _is_warm
    try:
        with event.install_listener("numba:compile", _Refusal()), suppress(NotCompiledError):
            warm_up_for_basics()
            load_kept()
            _is_warm = not progress()["of"]
    except Exception:  # a worker tries again, and reports it
        _log.exception("the workers are not forked warm")
