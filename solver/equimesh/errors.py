"""The exceptions of the solver: one tree, drawn here.

::

    EquimeshError             the root of all packages, of :mod:`equimesh_coupling.errors`
    ├── CouplingError         a mesh does not reach another library, or values do not come back; drawn there
    ├── InputError            an argument cannot be used, of :mod:`equimesh_coupling.errors`, too
    │   ├── ExpressionError   ... at a position inside the expression
    │   ├── SamplesError      ... in an array of samples, names the first bad index
    │   └── DecompositionError ... subdomains, overlap and grid do not fit together
    └── SolveError            a solve ended without the requested mesh, and carries its partial solution;
                              it is defined in :mod:`equimesh.solving.solution`, next to the solution
"""

from dataclasses import dataclass

from equimesh_coupling.errors import EquimeshError, InputError

__all__ = ["DecompositionError", "EquimeshError", "ExpressionError", "InputError", "Position", "SamplesError"]


@dataclass(frozen=True)
class Position:
    """A place inside an expression: 0-based ``offset``, 1-based ``line`` and ``column`` (in characters)."""

    offset: int
    line: int
    column: int


class ExpressionError(InputError):
    """An expression that does not parse, uses a name that is not allowed, or has no finite value."""

    def __init__(self, message: str, *, position: Position | None = None, field: str = "") -> None:
        super().__init__(message, field=field)
        self.position = position


class SamplesError(InputError):
    """Samples that are not finite, not ordered, of the wrong shape, or do not cover the domain.

    ``columns`` are the names of the columns of a file, one of which is u, where the sender has to choose it. ``index``
    is the place of a bad entry in nested lists, where there is a single one.
    """

    def __init__(
        self, message: str, *, field: str = "", columns: tuple[str, ...] = (), index: tuple[int, ...] = ()
    ) -> None:
        super().__init__(message, field=field)
        self.columns, self.index = columns, index


class DecompositionError(InputError):
    """A number of subdomains or an overlap that does not fit the grid."""
