"""The problem of a domain in blocks: a monitor that measures the error of u on cells, and the domain."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError
from equimesh.inputs import describe_value
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution

NO_LINES = (
    "a metric is equidistributed along grid lines from side to side, and lines that run through several blocks meet"
    " re-entrant corners, where no such mesh exists: take LeastError(u=...) or Auto(u=...), which measure the error on"
    " cells and need no lines"
)
"""Why other monitors are refused."""
NO_STRAIGHT_LINES = "rectilinear = True: a domain in blocks has no lines that could stay straight; leave it out"
"""Why straight lines are refused."""
NO_CELL_CENTRES = (
    "purpose = 'finite_volume': candidates are compared on grids, not on blocks; leave the purpose out, and bound the"
    " angles by orthogonality, 50 for instance"
)
"""Why the purpose is refused."""

NO_ANGLES_OF_A_ROUND = (
    "a round of adapting does not bound angles on blocks: leave the bound out, or take LeastError with the same values"
    " as u, QuadField(mesh=..., values=...), and the bound"
)
"""Why a bound of angles is refused for the values of a solver."""


@dataclass(frozen=True, kw_only=True)
class BlockProblem:
    """The mesh of a ``domain`` in blocks on which the error of interpolating u is least.

    ``monitor`` is a :class:`~equimesh.monitors.least_error.LeastError`, an
    :class:`~equimesh.monitors.least_error.Auto`, which chooses its weights, or a
    :class:`~equimesh.monitors.least_error.NodalSolution` with values on a mesh of the
    domain. It is bound to the domain. The mesh has the nodes, cells and sides of the initial mesh of the domain, with
    other positions of the nodes.

    Raises :class:`~equimesh.errors.InputError` for other monitors and domains, and where u is not finite.
    """

    monitor: LeastError | Auto | NodalSolution
    domain: Blocks

    def __post_init__(self) -> None:
        if not isinstance(self.domain, Blocks):
            raise InputError(
                f"domain is {describe_value(self.domain)}, and not in blocks: give Blocks.of(...), or the Problem of a"
                " grid",
                field="domain",
            )
        monitor = self.monitor
        if not isinstance(monitor, LeastError | Auto | NodalSolution):
            raise InputError(NO_LINES, field="monitor")
        if isinstance(monitor, LeastError) and monitor.rectilinear:
            raise InputError(NO_STRAIGHT_LINES, field="monitor.rectilinear")
        if isinstance(monitor, Auto) and monitor.purpose is not None:
            raise InputError(NO_CELL_CENTRES, field="monitor.purpose")
        if isinstance(monitor, NodalSolution) and monitor.orthogonality is not None:
            raise InputError(NO_ANGLES_OF_A_ROUND, field="monitor.orthogonality")
        object.__setattr__(self, "monitor", monitor.on(self.domain))

    @property
    def points(self) -> int:
        """Number of nodes."""
        return len(self.domain.mesh.points)
