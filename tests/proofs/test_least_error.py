"""Least-error meshes: never worse than the uniform mesh, never folded, for any function, domain and units."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from random_functions import random_functions

import equimesh as em
from solver.bent import CURVED, SECTOR

SEED = 20_261_122
"""Constants of the method were not tuned to the functions of this seed."""
ORDINARY, EVERYTHING = 8, 200
UNSEEN = [
    pytest.param(one.u, id=f"{number} {one.kind}", marks=() if number < ORDINARY else pytest.mark.everything)
    for number, one in enumerate(random_functions(SEED, EVERYTHING))
]
MAX_APART_CELLS = 0.05
"""The largest distance of two meshes that differ by rounding alone, in cells."""
FRONT = "tanh(20*((x - 0.4)**2 + (y - 0.3)**2 - 0.3))"


@cache
def solved(u: str, n_xi: int, n_eta: int | None = None, domain: em.Domain | None = None, **asked: Any) -> em.Solution:
    monitor = em.LeastError(u=em.Expression(u), **asked)
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=n_xi, n_eta=n_eta or n_xi), domain=domain or em.Rectangle())
    return em.solve(problem, threads=1)


def check(solution: em.Solution, norm: str) -> None:
    """Not folded, and no worse than uniform in L2 and in the requested norm, also where the gain is an estimate."""
    errors = solution.interpolation
    assert errors is not None
    assert solution.status is em.Status.COMPLETED
    assert solution.certificate.min_jacobian > 0.0
    assert not solution.mesh.is_folded
    for one in {"l2", norm}:
        assert errors.estimated_gain(one) >= 1.0


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("u", UNSEEN)
def test_no_unseen_function_is_worse_than_on_the_uniform_mesh(u: str, norm: str) -> None:
    check(solved(u, 33, norm=norm), norm)


@pytest.mark.parametrize(("degree", "norm"), [(2, "l2"), (3, "h1")])
@pytest.mark.parametrize("u", UNSEEN[:2])
def test_no_unseen_function_is_worse_for_elements_of_higher_degree(u: str, degree: int, norm: str) -> None:
    solution = solved(u, 17, norm=norm, degree=degree)
    assert solution.interpolation.degree == degree
    check(solution, norm)


@pytest.mark.parametrize(("norm", "cells"), [("l2", "quad"), ("h1", "triangle")])
@pytest.mark.parametrize(
    ("domain", "u"),
    [
        (em.Rectangle(x=(0, 1000), y=(0, 10)), "tanh(20*((x/1000 - 0.4)**2 + (y/10 - 0.3)**2 - 0.3))"),
        (SECTOR, FRONT),
        (CURVED, FRONT),
    ],
    ids=["long", "sector", "curved"],
)
def test_every_domain_and_any_grid_gain(domain: em.Domain, u: str, norm: str, cells: str) -> None:
    n_xi, n_eta = (33, 25) if cells == "quad" else (12, 40)
    solution = solved(u, n_xi, n_eta, domain, norm=norm, cells=cells)
    check(solution, norm)
    assert solution.interpolation.estimated_gain(norm) > 1.2


@pytest.mark.parametrize(
    ("u", "least", "most_steps"),
    [
        ("(1 - exp(15*(x - 1)))*sin(pi*y)", 4.4, 130),
        ("tanh(20*((x - .5)**2 + (y - .5)**2 - .09))", 1.9, 120),
        ("tanh(60*(x + y/2 - .75))", 40.0, 260),
        ("exp(-x/.001) + exp(-y/.001)", 1000.0, 120),
    ],
    ids=["paper", "ring20", "tanh60", "layers"],
)
def test_gains_at_65_points_a_side(u: str, least: float, most_steps: int) -> None:
    solution = solved(u, 65)
    errors = solution.interpolation
    assert errors.gain_l2 > least
    assert len(solution.descent) <= most_steps


def check_same(one: em.Solution, other: em.Solution, norm: str) -> None:
    """The same mesh but for what a hundred steps make of rounding: a few hundredths of a cell."""
    assert one.reference.distance(other.reference) < MAX_APART_CELLS / (one.problem.grid.n_xi - 1)
    first, second = one.interpolation, other.interpolation
    assert second.estimated_gain(norm) == pytest.approx(first.estimated_gain(norm), rel=0.002)


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("factor", [1e-8, 1e8])
def test_units_of_u_do_not_change_the_mesh(factor: float, norm: str) -> None:
    first, scaled = solved(FRONT, 33, norm=norm), solved(f"{factor}*({FRONT})", 33, norm=norm)
    check_same(first, scaled, norm)


@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_units_of_length_do_not_change_the_mesh(size: float, norm: str) -> None:
    u = f"tanh(20*((x/{size} - 0.4)**2 + (y/{size} - 0.3)**2 - 0.3))"
    first, scaled = solved(FRONT, 33, norm=norm), solved(u, 33, None, em.Rectangle(x=(0, size), y=(0, size)), norm=norm)
    check_same(first, scaled, norm)


def test_a_solve_repeats_itself_to_the_last_bit() -> None:
    one, other = solved(FRONT, 40, 33), solved.__wrapped__(FRONT, 40, 33)
    assert np.array_equal(one.mesh.x, other.mesh.x)
    assert np.array_equal(one.mesh.y, other.mesh.y)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_samples_and_nodal_values_gain_like_the_function(norm: str) -> None:
    u, grid = em.Expression(FRONT), em.Grid(n_xi=25, n_eta=25)
    line = np.linspace(0.0, 1.0, 41)
    x, y = np.meshgrid(line, line, indexing="ij")
    values = u.evaluate(x, y)[0]
    fields = {
        "grid": em.GridSamples(x=line, y=line, values=values),
        "scattered": em.ScatteredSamples(points=np.column_stack([x.ravel(), y.ravel()]), values=values.ravel()),
        "nodal": em.NodalField(mesh=em.Mesh.uniform(em.Grid(n_xi=41, n_eta=41)), values=values),
    }
    for field in fields.values():
        solution = em.solve(em.Problem(monitor=em.LeastError(u=field, norm=norm), grid=grid), threads=1)
        check(solution, norm)
        assert solution.interpolation.estimated_gain(norm) > 1.2
