"""The functions of the benchmark of least error, and the goals of its developers for them."""

from __future__ import annotations

from typing import NamedTuple


class Goal(NamedTuple):
    """An expression of x and y, and the L2 gains to reach on 65 x 65 points: with defaults, with little smoothness."""

    u: str
    default: float | None = None
    rough: float | None = None


POINTS = 65
"""Points a side that the gains are for."""
ROUGH = 0.1
"""Little smoothness."""
CURVED = {
    "paper": Goal("(1 - exp(15*(x - 1)))*sin(pi*y)", 4.4, 5.1),
    "ring20": Goal("tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", 2.0, 2.2),
    "ring100": Goal("tanh(100*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", 10.0, 12.0),
    "tanh60": Goal("tanh(60*(x + y/2 - 0.75))", 40.0, 80.0),
    "wave30": Goal("tanh(30*(y - 0.5 - 0.25*sin(2*pi*x)))", 11.0, 14.0),
    "gauss": Goal("exp(-50*((x - 0.5)**2 + (y - 0.5)**2))", 3.2, 3.9),
    "cross": Goal("tanh(30*(x - y)) + tanh(30*(x + y - 1))", 20.0, 28.0),
    "smooth": Goal("sin(2*pi*x)*sin(2*pi*y)", 1.5, 1.65),
}
LAYERS = {
    "layers": Goal("exp(-x/0.001) + exp(-y/0.001)", 1000.0),
    "outflow": Goal("(x - exp((x - 1)/0.001))*(y - exp((y - 1)/0.001))", 1000.0),
    "upright": Goal("tanh(100*(x - 0.37))", 300.0),
    "corner": Goal("(x**2 + y**2)**(1/3)", 25.0),
}
COSTS = {65: 12.0, 257: 5.0, 1025: 3.0}
"""Microseconds of CPU time for a point, by points a side."""
EQUAL_VERTICES = {"paper": 1.0, "ring20": 1.0, "ring100": 1.0, "gauss": 1.0}
"""Our error over that of Mmg2d with as many vertices; 2 for other functions."""
EQUAL_VERTICES_ELSEWHERE = 2.0
