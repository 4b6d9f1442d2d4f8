"""The family of subdomains of a transmission condition."""

from equimesh.equations.problem import Problem
from equimesh.schwarz.conditions import Optimized
from equimesh.schwarz.functionals.subdomains import FunctionalSubdomains
from equimesh.schwarz.holding.port import Holding
from equimesh.schwarz.optimized.subdomains import OptimizedSubdomains
from equimesh.schwarz.ordering import Ordering
from equimesh.schwarz.port import Subdomains
from equimesh.schwarz.settings import Schwarz


def subdomains_of(problem: Problem, holding: Holding, settings: Schwarz, *, enough: float, threads: int) -> Subdomains:
    """The subdomains of a decomposition that are held here, with the transmission condition of the settings.

    Local solves may end when they move their nodes by no more than ``enough``.
    """
    condition = settings.transmission
    if not isinstance(condition, Optimized):
        return FunctionalSubdomains(problem, holding, condition, settings.solved_by)
    return OptimizedSubdomains(
        problem,
        holding,
        condition,
        settings.solved_by,
        in_turns=settings.ordering is not Ordering.PARALLEL,
        enough=enough,
        threads=threads,
    )
