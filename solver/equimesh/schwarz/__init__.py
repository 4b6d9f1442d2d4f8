"""The nonlinear Schwarz iteration. Begin reading in ``iteration.py``."""

from equimesh.schwarz.rates import predicted_rate, steps_to_exact
from equimesh.schwarz.records import observed_rate

__all__ = ["observed_rate", "predicted_rate", "steps_to_exact"]
