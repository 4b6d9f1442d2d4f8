"""One definition for both clients: each operation is a coroutine, which the blocking client runs without an event loop.

An :class:`operation` of a class that is :class:`Awaiting` is the coroutine itself. In a class that is
:class:`Blocking` it is a plain method. Its transport never suspends, so the coroutine ends at its first step, and the
blocking client also works in a thread whose event loop is running.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine, Iterator
from functools import cache, wraps
from types import FunctionType, MethodType
from typing import Any, ClassVar, Concatenate, Generic, ParamSpec, TypeVar, get_args, get_origin, overload

from equimesh_client.wire.transport import AsyncTransport, BlockingTransport, Transport

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
END = object()


class Blocking:
    """A class whose operations are plain methods."""

    _transport: ClassVar[type[Transport]] = BlockingTransport


class Awaiting:
    """A class whose operations are coroutines and asynchronous iterators."""

    _transport: ClassVar[type[Transport]] = AsyncTransport


class operation(Generic[P, R]):
    """A method that waits for the service, from a coroutine or from a function that returns an asynchronous iterator.

    Help and signature are those of the coroutine. The type of the result names the classes of the client in place of
    type variables, and what a plain method returns in place of an asynchronous iterator.
    """

    def __init__(self, method: Callable[Concatenate[Any, P], R]) -> None:
        self._method = method

    @overload
    def __get__(self, of: Awaiting, owner: type) -> Callable[P, R]: ...
    @overload
    def __get__(self: operation[P, Coroutine[Any, Any, T]], of: Blocking, owner: type) -> Callable[P, T]: ...
    @overload
    def __get__(self: operation[P, AsyncIterator[T]], of: Blocking, owner: type) -> Callable[P, Iterator[T]]: ...
    @overload
    def __get__(self, of: object, owner: type) -> Callable[..., Any]: ...
    def __get__(self, of: object, owner: type) -> Callable[..., Any]:
        method = _method_of(owner, self._method)
        return method if of is None else MethodType(method, of)


@cache
def _method_of(owner: type, coroutine: Any) -> Any:
    """The method of a class, from the coroutine."""
    is_plain = issubclass(owner, Blocking)
    method: Any = _plain(coroutine) if is_plain else _copy(coroutine)
    signature = inspect.signature(coroutine)
    names = _names(owner) | ({"AsyncIterator": "Iterator"} if is_plain else {})
    result = re.sub(r"\w+", lambda word: names.get(word[0], word[0]), str(signature.return_annotation))
    method.__signature__ = signature.replace(return_annotation=result)
    method.__annotations__ = {**coroutine.__annotations__, "return": result}
    method.__qualname__, method.__module__ = f"{owner.__qualname__}.{coroutine.__name__}", owner.__module__
    return method


def _plain(coroutine: Any) -> Any:
    """A plain function that runs the coroutine to its end."""
    run: Callable[[Any], Any] = finish if inspect.iscoroutinefunction(coroutine) else each

    @wraps(coroutine)
    def method(*args: Any, **more: Any) -> Any:
        return run(coroutine(*args, **more))

    return method


def _copy(coroutine: FunctionType) -> FunctionType:
    """The same function, with attributes of its own."""
    code, defaults = coroutine.__code__, coroutine.__defaults__
    copied = FunctionType(code, coroutine.__globals__, coroutine.__name__, defaults, coroutine.__closure__)
    copied.__kwdefaults__ = coroutine.__kwdefaults__
    return copied


def _names(owner: type) -> dict[str, str]:
    """The name of the class for each type variable of the bases of ``owner``."""
    names = {}
    for base in getattr(owner, "__orig_bases__", ()):
        for variable, given in zip(getattr(get_origin(base), "__parameters__", ()), get_args(base), strict=False):
            names[variable.__name__] = str(getattr(given, "__forward_arg__", None) or given.__name__)
    return names


def finish(coroutine: Coroutine[Any, Any, T]) -> T:
    """The result of a coroutine whose transport never suspends."""
    try:
        coroutine.send(None)
    except StopIteration as done:
        result: T = done.value
        return result
    finally:
        coroutine.close()
    raise RuntimeError("a coroutine of the blocking client waits for an event loop, which it does not have")


def each(items: AsyncGenerator[T, None]) -> Iterator[T]:
    """The items of an asynchronous generator whose transport never suspends."""

    async def following() -> Any:
        return await anext(items, END)

    while (item := finish(following())) is not END:
        try:
            yield item
        except BaseException:  # also that it is closed
            finish(items.aclose())
            raise
