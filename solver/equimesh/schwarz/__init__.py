"""The nonlinear Schwarz iteration. Begin reading in ``iteration.py``."""

from equimesh.schwarz.decomposition import Ordering
from equimesh.schwarz.rates import predicted_rate, steps_to_exact
from equimesh.schwarz.records import observed_rate
from equimesh.schwarz.settings import Acceleration, LocalSolver, Schwarz

__all__ = [
    "Acceleration",
    "LocalSolver",
    "Ordering",
    "Schwarz",
    "observed_rate",
    "predicted_rate",
    "steps_to_exact",
]
