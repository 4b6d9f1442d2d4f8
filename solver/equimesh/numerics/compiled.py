"""Compilation of the project's loops to machine code, or loading of what was compiled before."""

import gc
import logging
import pickle
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from enum import StrEnum
from functools import cache
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numba
from numba.core import caching, compiler, dispatcher, serialize, sigutils
from numba.core.runtime import nrt

from equimesh.numerics import stamps
from equimesh.numerics.machine_code import (
    Archive,
    DamagedError,
    Folder,
    Key,
    find_archive,
    find_folder,
    opened,
    sealed,
    stem,
)
from equimesh.numerics.processor import TARGET, Pipeline

P = ParamSpec("P")
R = TypeVar("R")
# Parts of Numba whose types nobody has written down.
_numba: Any = numba
_caching: Any = caching
_compiler: Any = compiler
_dispatcher: Any = dispatcher
_serialize: Any = serialize
_nrt: Any = nrt
_sigutils: Any = sigutils

# Flags that let the compiler use vector instructions. Results still do not change from run to run.
FAST_MATH = {"contract", "nsz", "arcp", "reassoc", "nnan", "ninf"}
# Every loop of the modules that were imported; not those that are compiled inside their callers.
_loops: list[Any] = []
_log = logging.getLogger(__name__)


class Origin(StrEnum):
    """Where the machine code of a loop came from."""

    ARCHIVE = "archive"
    FOLDER = "folder"
    COMPILED = "compiled"


origins: dict[Key, Origin] = {}
"""Where each loop of this process came from."""


class Compiled(NamedTuple):
    """How many loops are ``compiled``, in this process or on disk for this processor, ``of`` how many."""

    compiled: int
    of: int


class Kept(NamedTuple):
    """How many loops are kept where: in the ``archive``, only in the ``folder`` of the user, ``nowhere``."""

    archive: int
    folder: int
    nowhere: int


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, which is kept for other processes; holds no interpreter lock."""
    return _listed(_compile(function, fastmath=False))


def vectorised(function: Callable[P, R]) -> Callable[P, R]:
    """As :func:`compiled`, for loops whose sums may be reordered, and whose results are never tested for NaN."""
    return _listed(_compile(function, fastmath=FAST_MATH))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """As :func:`vectorised`, for a part of such a loop: compiled as if it were written inside its caller."""
    return _compile(function, fastmath=FAST_MATH, inline="always")


def count_compiled() -> Compiled:
    """How many of the project's loops are compiled now, also by other processes; takes a few milliseconds."""
    kept = [kept.stems() for kept in (find_archive(), find_folder()) if not isinstance(kept, str)]
    return Compiled(
        sum(bool(loop.overloads) or any(_is_kept(loop, stems) for stems in kept) for loop in _loops), len(_loops)
    )


def count_kept() -> Kept:
    """Where the machine code of the project's loops is kept now."""
    archive, folder = (set() if isinstance(kept, str) else kept.stems() for kept in (find_archive(), find_folder()))
    archived = [_is_kept(loop, archive) for loop in _loops]
    others = [_is_kept(loop, folder) for loop, is_archived in zip(_loops, archived, strict=True) if not is_archived]
    return Kept(sum(archived), sum(others), len(others) - sum(others))


def kept_entries() -> dict[str, bytes]:
    """What is kept of the project's loops and of those that this process has used, also of loops inside others.

    Raises :class:`RuntimeError` where a loop that was used is not kept.
    """
    wanted = {loop._cache.key("").stem for loop in _loops if isinstance(loop._cache, _LoopCache)}
    entries = dict[str, bytes]()
    for place in (find_folder(), find_archive()):
        if not isinstance(place, str):
            found = {name: place.read(name) for name in place.names() if stem(name) in wanted}
            entries |= {name: entry for name, entry in found.items() if entry is not None}
    if lost := sorted({key.loop for key in origins if key.stem in wanted and key.name not in entries}):
        folder = find_folder()
        raise RuntimeError(f"{lost[0]} is not kept{f'; {folder}' if isinstance(folder, str) else ''}")
    return entries


def load_kept() -> None:
    """Load the project's loops for all types that they are kept for; those of modules that were imported."""
    loops = {loop._cache.key("").stem: loop for loop in _loops if isinstance(loop._cache, _LoopCache)}
    for place in (find_archive(), find_folder()):
        if isinstance(place, str):
            continue
        for name in place.names():
            loop = loops.get(stem(name))
            entry = None if loop is None else place.read(name)
            if loop is not None and entry is not None:
                with suppress(DamagedError):
                    loop.compile(pickle.loads(opened(entry))[1])


def is_loop(machine_code: Any) -> bool:
    """Whether this is one of the project's loops, and no function that a user of the package compiles."""
    return any(machine_code is loop for loop in _loops)


def _listed(machine_code: Callable[P, R]) -> Callable[P, R]:
    if getattr(machine_code, "__module__", "").startswith("equimesh."):
        _loops.append(machine_code)
    return machine_code


def _is_kept(loop: Any, stems: set[str]) -> bool:
    return bool(stems) and isinstance(loop._cache, _LoopCache) and loop._cache.key("").stem in stems


def _compile(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    # Without a wrapper for callers in C, which nothing has, compiling takes less time.
    machine_code: Any = _numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)(function)
    if isinstance(machine_code, _dispatcher.Dispatcher):  # not where NUMBA_DISABLE_JIT is set
        machine_code._cache = _LoopCache(function)
        machine_code._compiler = _LoopCompiler(machine_code)
    return machine_code  # type: ignore[no-any-return]


@cache
def _initialise(target_context: Any) -> None:
    """Let Numba register what machine code needs, once; whoever compiles registers more himself, which takes 0.2 s."""
    _nrt.rtsys.initialize(target_context)


@contextmanager
def _without_garbage() -> Iterator[None]:
    """No search for unreachable objects while a loop is compiled, which makes so many others that it takes a tenth."""
    is_outermost = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if is_outermost:
            gc.enable()


class _LoopCache(_caching._Cache):  # type: ignore[misc]
    """What Numba asks for the machine code of one loop: the archive, then the folder of the user."""

    def __init__(self, function: Callable[..., Any]) -> None:
        stamps.note(function)
        self._function = function
        self._name = re.sub(r"[^\w.]+", "_", f"{function.__module__}.{function.__qualname__}")

    def key(self, types: Any) -> Key:
        return Key(self._name, stamps.stamp_of(self._function), str(types))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        _initialise(target_context)
        types = tuple(_sigutils.normalize_signature(sig)[0])
        return self._loaded(find_archive(), types, Origin.ARCHIVE) or self._loaded(find_folder(), types, Origin.FOLDER)

    def compiled(self, types: Any, compile_it: Callable[[], Any]) -> Any:
        """Compile the loop, unless another process does it now: then wait, and load what it kept."""
        folder, key = find_folder(), self.key(types)
        with nullcontext() if isinstance(folder, str) else folder.turn(key.name):
            result = self._loaded(folder, types, Origin.FOLDER)
            if result is not None:
                context = TARGET.target_context
                context.insert_user_function(result.entry_point, result.fndesc, [result.library])
                return result
            with _without_garbage():
                result = compile_it()
            origins[key] = Origin.COMPILED
            # Code with addresses of this process is of no use to others.
            if not isinstance(folder, str) and not result.lifted and not result.library.has_dynamic_globals:
                folder.write(key.name, sealed(_serialize.dumps((key, types, result._reduce()))))
        return result

    def _loaded(self, kept: Archive | Folder | str, types: Any, origin: Origin) -> Any:
        key = self.key(types)
        entry = None if isinstance(kept, str) else kept.read(key.name)
        if entry is None:
            return None
        try:
            found, its_types, content = pickle.loads(opened(entry))
            if (found, its_types) != (key, types):
                return None
            result = _compiler.CompileResult._rebuild(TARGET.target_context, *content)
        except DamagedError:
            _log.warning("the compiled loop %s in the %s is damaged; it is compiled anew", key.loop, origin)
            return None
        except Exception:  # whatever Numba finds wrong with it: the loop can be compiled
            _log.warning("the compiled loop %s in the %s cannot be loaded", key.loop, origin, exc_info=True)
            return None
        origins[key] = origin
        return result

    @property
    def cache_path(self) -> str | None:
        folder = find_folder()
        return None if isinstance(folder, str) else str(folder.path)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Nothing: the loop was kept when it was compiled, before other processes had their turn."""

    def enable(self) -> None: ...
    def disable(self) -> None: ...
    def flush(self) -> None: ...


class _LoopCompiler(_dispatcher._FunctionCompiler):  # type: ignore[misc]
    """Compiles a loop for the level of the processor, one process at a time."""

    def __init__(self, loop: Any) -> None:
        super().__init__(loop.py_func, TARGET, loop.targetoptions, loop.locals, Pipeline)
        self._kept = loop._cache

    def compile(self, args: Any, return_type: Any) -> Any:
        return self._kept.compiled(tuple(args), lambda: super(_LoopCompiler, self).compile(args, return_type))
