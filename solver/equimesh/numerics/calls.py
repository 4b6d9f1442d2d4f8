"""Calls of compiled loops from other compiled code, such that both keep their own machine code.

A loop whose sums may be reordered has them in another order where the compiler makes it a part of its caller, or copies
it next to that. Called by its address it gives the same numbers from compiled code as from Python, to the last bit, and
its caller is compiled faster.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar, cast

from numba import typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

R = TypeVar("R")


class CalledAt(Protocol):
    """A way to call a compiled function."""

    def __call__(self, address: int, function: Callable[..., R], arguments: tuple[Any, ...], /) -> R:
        """``function(*arguments)``, whose machine code is at ``address``."""
        ...


def address_of(function: Any, *arguments: Any) -> int:
    """Where the machine code of a compiled ``function`` for arguments of these types is, in this process."""
    given = tuple(typeof(argument) for argument in arguments)  # type: ignore[no-untyped-call]
    function.compile(given)
    found = function.overloads[given]
    return int(found.library.get_pointer_to_function(found.fndesc.llvm_func_name))


def _called_at(typing: Any, address: Any, function: Any, arguments: Any) -> Any:
    given = tuple(types.unliteral(kind) for kind in arguments.types)  # type: ignore[no-untyped-call]
    called = function.get_call_type(typing, given, {})

    def call(context: Any, builder: Any, _: Any, values: Any) -> Any:
        kind = context.call_conv.get_function_type(called.return_type, called.args)
        code = builder.inttoptr(values[0], kind.as_pointer())
        parts = cgutils.unpack_tuple(builder, values[2])  # type: ignore[no-untyped-call]
        status, result = context.call_conv.call_function(builder, code, called.return_type, called.args, parts)
        with cgutils.if_unlikely(builder, status.is_error):  # type: ignore[no-untyped-call]
            context.call_conv.return_status_propagate(builder, status)
        return result

    return called.return_type(address, function, arguments), call


called_at = cast(CalledAt, intrinsic(_called_at))
"""``function(*arguments)`` from compiled code: the machine code is at the address that :func:`address_of` found for
arguments of the same types."""
