"""The nonlinear Schwarz iteration. Begin reading in ``iteration.py``."""

from equimesh.schwarz.history import observed_rate
from equimesh.schwarz.rates import predicted_rate, steps_to_exact

__all__ = ["observed_rate", "predicted_rate", "steps_to_exact"]
