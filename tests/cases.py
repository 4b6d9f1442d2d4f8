"""The functions that tests adapt to, by name: some of those of the benchmarks."""

from __future__ import annotations

import functions

import equimesh as em

FUNCTIONS = {name: functions.FUNCTIONS[name].u for name in ("paper", "sine", "ring", "tanh20", "gauss", "wave")}


def problem(
    name: str,
    n_xi: int,
    n_eta: int | None = None,
    *,
    boundary: em.Boundary = em.Boundary.TRACE,
    a: float = 0.7,
    b: float = 0.05,
    scaled: bool = False,
) -> em.Problem:
    """The mesh of one of the :data:`FUNCTIONS`, on a square grid unless ``n_eta`` is given. u is not scaled."""
    return em.Problem(
        monitor=em.ArcLength(u=em.Expression(FUNCTIONS[name]), a=a, b=b, scaled=scaled),
        grid=em.Grid(n_xi=n_xi, n_eta=n_eta or n_xi),
        boundary=boundary,
    )
