"""The functions that benchmarks and tests adapt to, by name, with the difficulty of each."""

from __future__ import annotations

from typing import NamedTuple


class Function(NamedTuple):
    """An expression of x and y, and its difficulty."""

    u: str
    hard: str


FUNCTIONS = {
    "paper": Function("(1 - exp(15*(x - 1))) * sin(pi*y)", "a layer along one side; that of the paper"),
    "sine": Function("sin(2*pi*x) * sin(2*pi*y)", "smooth, with four extrema and no front"),
    "ring": Function("tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", "a mild closed front"),
    "tanh20": Function("tanh(20*(x + y/2 - 0.75))", "a straight front oblique to the grid"),
    "tanh60": Function("tanh(60*(x + y/2 - 0.75))", "the same, thinner than the cells of coarse grids"),
    "diag100": Function("tanh(100*(x - y))", "a thin front through two corners, along the diagonal"),
    "gauss": Function("exp(-50*((x - 0.4)**2 + (y - 0.6)**2))", "a peak: lines must go around it on all sides"),
    "gauss200": Function("exp(-200*((x - 0.5)**2 + (y - 0.5)**2))", "a narrow peak, symmetric"),
    "wave": Function("tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))", "a steep front that bends both ways"),
    "cross": Function("tanh(30*(x - 0.5)) + tanh(30*(y - 0.5))", "two fronts along the grid that cross"),
    "xcross": Function("tanh(30*(x - y)) + tanh(30*(x + y - 1))", "two fronts along the diagonals that cross"),
    "cornerpeak": Function("exp(-30*(x**2 + y**2))", "a peak in a corner"),
    "cornerlayer": Function("(1 - exp(-30*x)) * (1 - exp(-30*y))", "two layers that meet in a corner"),
    "layers": Function("exp(-40*x) + exp(-40*(1 - y))", "two layers that cross in a corner"),
    "quarter": Function("tanh(40*(x**2 + y**2 - 0.5))", "a bent front that meets two sides"),
    "ringshock": Function("tanh(60*(sqrt((x - 0.5)**2 + (y - 0.5)**2 + 1e-4) - 0.3))", "a thin closed front"),
    "runge": Function("1/(1 + 100*((x - 0.5)**2 + (y - 0.5)**2))", "a peak with long slopes"),
    "franke": Function(
        "0.75*exp(-((9*x - 2)**2 + (9*y - 2)**2)/4) + 0.75*exp(-(9*x + 1)**2/49 - (9*y + 1)/10)"
        " + 0.5*exp(-((9*x - 7)**2 + (9*y - 3)**2)/4) - 0.2*exp(-(9*x - 4)**2 - (9*y - 7)**2)",
        "smooth hills and a dip, Franke's",
    ),
    "waves4": Function("sin(4*pi*x) * sin(4*pi*y)", "sixteen extrema, few cells for each"),
    "flower": Function(
        "tanh(30*(sqrt((x - 0.5)**2 + (y - 0.5)**2 + 1e-3) - 0.25 - 0.06*cos(5*atan2(y - 0.5001, x - 0.5001))))",
        "a closed front that bends both ways, with a pole of its angle inside",
    ),
    "twopeaks": Function(
        "exp(-80*((x - 0.3)**2 + (y - 0.3)**2)) + exp(-80*((x - 0.7)**2 + (y - 0.7)**2))",
        "two peaks on the diagonal, which pull the same lines two ways",
    ),
    "root": Function("sqrt(sqrt((x - 0.5)**2 + (y - 0.5)**2 + 1e-4))", "a cusp, nearly singular"),
    "burgers": Function("1/(1 + exp((x + y - 0.8)/(2*0.01)))", "a thin front along the other diagonal"),
    "spiralish": Function("sin(12*sqrt((x - 0.1)**2 + (y - 0.2)**2 + 0.01))", "bent waves without flat places between"),
}
