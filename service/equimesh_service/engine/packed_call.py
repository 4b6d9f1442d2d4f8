"""A call as bytes, and its outcome as bytes: processes in between need not import what is called."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any


@dataclass(frozen=True)
class PackedCall:
    """A picklable call of a function; calling it makes the call."""

    content: bytes

    @classmethod
    def of(cls, function: Callable[..., Any], *arguments: Any) -> PackedCall:
        """The call of a function with its arguments, all picklable."""
        return cls(pickle.dumps(partial(function, *arguments)))

    def __call__(self) -> Any:
        """The result of the call."""
        return pickle.loads(self.content)()


def pack_outcome(call: PackedCall) -> bytes:
    """The outcome of a call, its result or its exception, to be read by :func:`open_outcome`.

    Raises :class:`MemoryError`, after which the process may not have the memory to describe it.
    """
    try:
        return pack_result(call())
    except MemoryError:
        raise
    except Exception as error:
        return pack_error(error)


def pack_result(result: Any) -> bytes:
    """The outcome of a call that returned."""
    return pickle.dumps((result, None))


def pack_error(error: BaseException) -> bytes:
    """The outcome of a call that raised."""
    try:
        packed = pickle.dumps((None, error))
        pickle.loads(packed)
    except Exception:  # an exception that cannot be sent
        packed = pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
    return packed


def open_outcome(outcome: bytes) -> Any:
    """The result of a packed outcome; raises its exception."""
    result, error = pickle.loads(outcome)
    if error is not None:
        raise error
    return result
