"""Calls from compiled code by address: of compiled loops, such that both keep their own code, and of NumPy's loops.

A loop whose sums may be reordered has them in another order where the compiler makes it a part of its caller, or copies
it next to that. Called by its address it gives the same numbers from compiled code as from Python, to the last bit, and
its caller is compiled faster.
"""

import ctypes
from collections.abc import Callable
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from llvmlite import ir
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


class _UfuncHead(ctypes.Structure):
    """What ``PyUFuncObject`` of NumPy's C interface begins with, behind the head of every object."""

    _fields_ = (
        ("nin", ctypes.c_int),
        ("nout", ctypes.c_int),
        ("nargs", ctypes.c_int),
        ("identity", ctypes.c_int),
        ("functions", ctypes.POINTER(ctypes.c_void_p)),
        ("data", ctypes.POINTER(ctypes.c_void_p)),
        ("ntypes", ctypes.c_int),
    )


def loop_of(function: np.ufunc) -> tuple[int, int]:
    """Where the loop over 64-bit numbers of a function of NumPy or SciPy is in this process, and what it is given."""
    head = _UfuncHead.from_address(id(function) + object.__basicsize__)
    known = function.nin, function.nout, function.nargs, function.ntypes
    if (head.nin, head.nout, head.nargs, head.ntypes) != known:
        raise RuntimeError(f"this version of NumPy keeps the loops of {function.__name__} elsewhere")
    number = function.types.index(f"{'d' * function.nin}->d")
    return int(head.functions[number] or 0), int(head.data[number] or 0)


def _numpy_loop(_: Any, address: Any, arguments: Any, count: Any, strides: Any, given: Any) -> Any:
    def call(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        whole, byte = ir.IntType(64), ir.IntType(8).as_pointer()
        kinds = [byte.as_pointer(), whole.as_pointer(), whole.as_pointer(), byte]
        code = ir.FunctionType(ir.VoidType(), kinds).as_pointer()
        passed = [builder.inttoptr(value, kind) for value, kind in zip(values[1:], kinds, strict=True)]
        builder.call(builder.inttoptr(values[0], code), passed)

    return types.void(address, arguments, count, strides, given), call


numpy_loop = cast(Callable[[int, int, int, int, int], None], intrinsic(_numpy_loop))
"""Runs a loop that :func:`loop_of` found, from compiled code.

The first address is that of the loop, the last what it is given. Between them are those of three arrays: the addresses
of what it reads and writes, the length, and the strides in bytes."""
