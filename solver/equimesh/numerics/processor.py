"""What loops are compiled for: a level of processors, such that all machines of a level run the same code; and how."""

import dis
import hashlib
import importlib.machinery
from functools import cache
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numba
from numba.core import (
    codegen,
    compiler,
    compiler_machinery,
    config,
    ir,
    registry,
    typed_passes,
    types,
    typing,
    untyped_passes,
)

# What a processor has to have for the code of a level; the first level that fits is taken.
LEVELS = {
    "x86-64-v3": ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "x86-64-v2": ("cx16", "popcnt", "sse3", "sse4.1", "sse4.2", "ssse3"),
}
# Parts of Numba whose types nobody has written down.
_codegen: Any = codegen
_config: Any = config
_registry: Any = registry
_llvm: Any = llvm
_compiler: Any = compiler
_machinery: Any = compiler_machinery
_ir: Any = ir
_types: Any = types
_typing: Any = typing
_typed_passes: Any = typed_passes
_untyped_passes: Any = untyped_passes
# Types whose operators have the same signature wherever they stand.
_VALUES = (types.Number, types.Boolean, types.Literal, types.Array, types.BaseTuple, types.SliceType, types.NoneType)
# What stands in the bytecode of a function with a function or a comprehension inside.
_COMPREHENSIONS = {"MAKE_FUNCTION", "LIST_APPEND", "SET_ADD", "MAP_ADD"}


class Level(NamedTuple):
    """A level of processors: its name, and the ``processor`` and ``features`` that LLVM compiles for."""

    name: str
    processor: str
    features: str = ""


@cache
def level() -> Level:
    """The level of this processor; that of ``NUMBA_CPU_NAME`` where it is set; the processor itself without levels."""
    if _config.CPU_NAME is not None:
        return _named(_config.CPU_NAME, _config.CPU_FEATURES or "")
    machine = _llvm.get_process_triple().split("-")[0]
    if machine in ("aarch64", "arm64"):
        return Level("aarch64", "generic")
    if machine == "x86_64":
        here = _llvm.get_host_cpu_features()
        for name, needed in LEVELS.items():
            if all(here.get(feature) for feature in needed):
                return Level(name, name)
    return _named(_llvm.get_host_cpu_name(), _codegen.get_host_cpu_features())


@cache
def tag() -> str:
    """What machine code has to be made for to run here: system, Python, Numba, llvmlite and level of the processor."""
    python = importlib.machinery.EXTENSION_SUFFIXES[0].strip(".").rpartition(".")[0]
    vectors = "-svml" if _config.USING_SVML else ""  # Intel's library of vector functions, whose code calls it
    return f"{python}-numba{numba.__version__}-llvmlite{llvmlite.__version__}-{level().name}{vectors}"


class _LevelTarget(_registry.CPUTarget):  # type: ignore[misc]
    """Numba's target for processors, with code for the level in place of the processor of this machine.

    Types and functions are those of Numba's own target. Other functions of a program are compiled as always.
    """

    @property
    def typing_context(self) -> Any:
        return _context().typing_context

    @property
    def target_context(self) -> Any:
        return _context()


class _LevelCodegen(_codegen.JITCPUCodegen):  # type: ignore[misc]
    def _get_host_cpu_name(self) -> str:
        return level().processor

    def _get_host_cpu_features(self) -> str:
        return level().features


TARGET: Any = _LevelTarget("cpu")
"""The target of the project's loops."""


@cache
def _context() -> Any:
    own, codegen = _registry.cpu_target.target_context, _LevelCodegen("equimesh.exec")
    return own.subtarget(_internal_codegen=codegen, typing_context=_Typing(own.typing_context))


def _named(processor: str, features: str) -> Level:
    digest = f"-{hashlib.sha256(features.encode()).hexdigest()[:8]}" if features else ""
    return Level(processor + digest, processor, features)


class _Operator(_types.Function):  # type: ignore[misc]
    """An operator of Python, which finds its signature for the same types once.

    Numba looks for it at every place where the operator stands, and tries all that NumPy can do with two numbers.
    """

    def __init__(self, operation: Any) -> None:
        super().__init__(operation.templates)
        self._signatures: dict[Any, Any] = {}

    def augment(self, other: Any) -> Any:
        return _types.Function(self.templates).augment(other)

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        if kws or not all(isinstance(kind, _VALUES) for kind in args):
            return super().get_call_type(context, args, kws)
        found = self._signatures.get(tuple(args))
        if found is None:
            found = self._signatures[tuple(args)] = super().get_call_type(context, args, kws)
        return found


class _Typing(_typing.Context):  # type: ignore[misc]
    """Numba's own types and functions, of which it is another view, with operators that are looked for once."""

    def __init__(self, own: Any) -> None:
        self.__dict__ = own.__dict__

    def _lookup_global(self, value: Any) -> Any:
        found = super()._lookup_global(value)
        is_operator = type(found) is _types.Function and getattr(value, "__module__", "") == "_operator"
        return _operator(found) if is_operator else found


@cache
def _operator(operation: Any) -> _Operator:
    return _Operator(operation)


@_machinery.register_pass(mutates_CFG=True, analysis_only=False)
class _Rewrites(_typed_passes.NopythonRewrites):  # type: ignore[misc]
    """Numba's rewriting of expressions with arrays, where one makes an array."""

    def run_pass(self, state: Any) -> bool:
        return bool(state.targetctx.enable_nrt and super().run_pass(state))


@_machinery.register_pass(mutates_CFG=False, analysis_only=False)
class _References(_machinery.FunctionPass):  # type: ignore[misc]
    """Leaves out the counting of references where a loop makes no array: those of its caller live longer.

    It must not be left out where an array comes from a call, whose result the loop would have to release.
    """

    _name = "equimesh_references"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        if not _makes_arrays(state):
            context = state.targetctx.subtarget(enable_nrt=False)
            vars(context).pop("nrt", None)  # that of the context it was copied from
            state.targetctx = context
        return False


class Pipeline(_compiler.CompilerBase):  # type: ignore[misc]
    """Numba's passes over a loop, without those that change nothing in this one."""

    def define_pipelines(self) -> list[Any]:
        manager = _compiler.DefaultPassBuilder.define_nopython_pipeline(self.state)
        replaced: dict[Any, Any] = {_typed_passes.NopythonRewrites: _Rewrites}
        if not any(step.opname in _COMPREHENSIONS for step in dis.get_instructions(self.state.func_id.code)):
            replaced[_untyped_passes.InlineClosureLikes] = None
        manager.passes = [(replaced.get(one, one), text) for one, text in manager.passes if replaced.get(one, one)]
        manager.add_pass_after(_References, _typed_passes.NopythonTypeInference)
        manager.finalize()
        return [manager]


def _makes_arrays(state: Any) -> bool:
    """Whether a variable of a loop, or what it returns, can hold an array that is none of its arguments or a part."""
    kinds, ir = state.typemap, state.func_ir
    if ir.is_generator or _holds_references(state, state.return_type):
        return True
    assigned = (one for block in ir.blocks.values() for one in block.body if isinstance(one, _ir.Assign))
    return any(_holds_references(state, kinds[one.target.name]) and not _is_part(one.value, kinds) for one in assigned)


def _holds_references(state: Any, kind: Any) -> bool:
    return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())


def _is_part(value: Any, kinds: Any) -> bool:
    """Whether a value is an argument, a constant, a view of an array, or a tuple with its members."""
    if not isinstance(value, _ir.Expr):
        return isinstance(value, (_ir.Arg, _ir.Var, _ir.Global, _ir.FreeVar))
    if value.op == "call":
        return isinstance(kinds[value.func.name], _types.NamedTupleClass)
    if value.op in ("build_tuple", "exhaust_iter", "cast", "phi"):
        return True
    if value.op not in ("getattr", "getitem", "static_getitem"):
        return False
    whole = kinds[value.value.name]
    if not isinstance(whole, _types.Array):
        return isinstance(whole, _types.BaseTuple)
    if value.op == "getattr":
        return bool(value.attr == "T")
    index = value.index if value.op == "getitem" else value.index_var
    return index is None or _is_plain(kinds[index.name])


def _is_plain(index: Any) -> bool:
    """Whether an index is none of arrays, which would make a copy."""
    if isinstance(index, _types.BaseTuple):
        return all(map(_is_plain, index))
    return isinstance(index, (_types.Integer, _types.SliceType, _types.EllipsisType))
