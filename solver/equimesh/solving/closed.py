"""Checks of problems on grids with closed lines."""

from equimesh.domains.closing import is_closed
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.monitors.monitor import map_of
from equimesh.schwarz.settings import Schwarz

NO_SUBDOMAINS = (
    "the lines of this domain are closed, and the subdomains of a Schwarz iteration end at sides: leave the Schwarz"
    " settings out, or take a domain without closed lines"
)
"""Why closed lines with Schwarz settings are refused."""
NO_GRADIENT_MAP = (
    "the gradient map of a weight needs four sides, and the lines of this domain are closed: take map = 'lines'"
)
"""Why closed lines with a gradient map are refused."""


def require_open(problem: Problem, schwarz: Schwarz | None) -> None:
    """Raises :class:`~equimesh.errors.InputError` for what closed lines cannot be solved with."""
    if not is_closed(problem.domain):
        return
    if schwarz is not None:
        raise InputError(NO_SUBDOMAINS, field="schwarz")
    if map_of(problem.monitor) != "lines":
        raise InputError(NO_GRADIENT_MAP, field="monitor.map")
