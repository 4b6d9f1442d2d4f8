"""The functions that tests and benchmarks adapt to, by name."""

from __future__ import annotations

import equimesh as em

FUNCTIONS = {
    "paper": "(1 - exp(15*(x - 1))) * sin(pi*y)",
    "sine": "sin(2*pi*x) * sin(2*pi*y)",
    "ring": "tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
    "tanh20": "tanh(20*(x + y/2 - 0.75))",
    "gauss": "exp(-50*((x - 0.4)**2 + (y - 0.6)**2))",
    "wave": "tanh(50*(y - 0.5 - 0.25*sin(2*pi*x)))",
}


def problem(
    name: str,
    n_xi: int,
    n_eta: int | None = None,
    *,
    boundary: em.Boundary = em.Boundary.TRACE,
    a: float = 0.7,
    b: float = 0.05,
) -> em.Problem:
    """The mesh of one of the :data:`FUNCTIONS`, on a square grid unless ``n_eta`` is given."""
    return em.Problem(
        monitor=em.ArcLength(u=em.Expression(FUNCTIONS[name]), a=a, b=b),
        grid=em.Grid(n_xi=n_xi, n_eta=n_eta or n_xi),
        boundary=boundary,
    )
