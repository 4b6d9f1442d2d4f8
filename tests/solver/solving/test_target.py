"""A mesh for a requested error."""

from __future__ import annotations

import math
from typing import Any

import pytest

import equimesh as em
from equimesh.rounds.shape import proportions
from equimesh.solving.target import require_reachable

PAPER = em.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
MONITOR = em.LeastError(u=PAPER)


@pytest.mark.parametrize(("norm", "error"), [("l2", 1e-4), ("h1", 0.06)])
def test_the_error_is_reached_on_the_predicted_grid(norm: Any, error: float) -> None:
    grids: list[em.Grid] = []
    target = em.Target(norm=norm, error=error)
    solution = em.solve_to(target, monitor=em.LeastError(u=PAPER, norm=norm), began=grids.append, threads=1)
    aim = solution.certificate.target
    assert aim is not None
    assert aim.grid == solution.problem.grid.shape == grids[-1].shape
    assert grids[0] == em.Grid(n_xi=33, n_eta=33)
    assert aim.solves == len(grids) <= 4
    assert solution.interpolation is not None
    assert aim.reached == getattr(solution.interpolation, norm)
    assert 0.8 * error <= aim.reached <= error
    assert aim.predicted == pytest.approx(aim.reached, rel=0.05)
    assert solution.certificate.summary()["target"]["grid"] == [*aim.grid]
    assert f"reached on {solution.problem.grid} points" in str(solution.certificate)


@pytest.mark.parametrize("kind", [em.LeastError, em.Auto])
def test_the_least_error_on_so_many_points_takes_a_shape_for_it(kind: Any) -> None:
    u, grids = em.Expression("exp(-30*y)"), list[em.Grid]()
    solution = em.solve_to(em.Target(max_points=300), monitor=kind(u), began=grids.append, threads=1)
    square = em.solve(em.Problem(monitor=kind(u), grid=grids[0]), threads=1)
    assert (grids[0], grids[-1]) == (em.Grid(17), solution.problem.grid)
    assert solution.problem.grid.n_eta > 6 * solution.problem.grid.n_xi
    assert solution.interpolation is not None
    assert square.interpolation is not None
    assert solution.interpolation.l2 < 0.3 * square.interpolation.l2


def test_a_target_needs_an_error_or_points() -> None:
    with pytest.raises(em.InputError, match="an error is required, or max_points") as refused:
        em.Target()
    assert refused.value.field == "error"


def test_the_order_of_the_degree_predicts_the_grid() -> None:
    solution = em.solve_to(em.Target(error=2e-6), monitor=em.LeastError(PAPER, degree=3), threads=1)
    aim = solution.certificate.target
    assert aim is not None
    assert aim.predicted == pytest.approx(aim.reached, rel=0.1)
    assert 0.8 * 2e-6 <= aim.reached <= 2e-6  # the first grid of 33 x 33 has a hundredth of that
    assert solution.problem.grid.points < 20 * 20
    assert solution.interpolation is not None
    assert (solution.interpolation.degree, aim.reached) == (3, solution.interpolation.l2)


def test_a_large_error_takes_a_coarse_grid() -> None:
    solution = em.solve_to(em.Target(error=3e-3), monitor=MONITOR, threads=1)
    assert solution.problem.grid.points < 33 * 33
    assert solution.target is not None
    assert solution.target.reached <= 3e-3


def test_what_no_allowed_grid_reaches_is_refused_with_the_error_that_it_would_give() -> None:
    target = em.Target(error=1e-6, max_points=50 * 50)
    with pytest.raises(em.InputError, match="the largest allowed grid, 50 x 50, would give about") as caught:
        em.solve_to(target, monitor=MONITOR, threads=1)
    assert caught.value.field == "target.error"
    told = float(caught.value.message.rsplit(" ", 1)[1])
    largest = em.solve(em.Problem(monitor=MONITOR, grid=em.Grid(n_xi=50, n_eta=50)), threads=1)
    assert largest.interpolation is not None
    assert told == pytest.approx(largest.interpolation.l2, rel=0.1)
    with pytest.raises(em.InputError, match="would give about"):
        require_reachable(target, monitor=MONITOR)
    require_reachable(em.Target(error=1e-4), monitor=MONITOR)


def test_the_largest_grid_is_within_the_limit() -> None:
    for most in (25, 100, 1089, 54321):
        for domain in (em.Rectangle(), em.Rectangle(x=(0, 7)), em.Rectangle(y=(0, 3))):
            target = em.Target(error=1.0, max_points=most)
            grid = target.grid(domain, target.largest_cells(domain))
            assert grid.points <= most or grid.points == 25 or min(grid.shape) == 5


@pytest.mark.parametrize(
    ("domain", "ratio"),
    [
        (em.Rectangle(), 1.0),
        (em.Rectangle(x=(0, 4)), 4.0),
        (em.Rectangle(x=(0, 1), y=(0, 1000)), 1 / 64),
        (em.AnnulusSector(radii=(1, 2), angles=(0, 90)), 1 / (1.5 * math.pi / 2)),
    ],
)
def test_cells_have_the_proportions_of_the_domain(domain: em.Domain, ratio: float) -> None:
    along_xi, along_eta = proportions(domain)
    assert along_xi / along_eta == pytest.approx(ratio, rel=0.01)
    assert along_xi * along_eta == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("values", "field"),
    [({"error": 0.0}, "error"), ({"error": math.inf}, "error"), ({"error": 1.0, "norm": "max"}, "norm"),
     ({"error": 1.0, "max_points": 24}, "max_points"), ({"error": "1"}, "error")],
)  # fmt: skip
def test_a_target_that_cannot_be_used_is_refused(values: dict[str, Any], field: str) -> None:
    with pytest.raises(em.InputError) as caught:
        em.Target(**values)
    assert caught.value.field == field


def test_a_target_needs_a_function_and_no_mesh() -> None:
    target = em.Target(error=1e-3)
    with pytest.raises(em.InputError, match="this monitor has no u"):
        em.solve_to(target, monitor=em.Weight(rho=PAPER))
    with pytest.raises(em.InputError, match="no mesh to start from"):
        em.solve_to(target, monitor=MONITOR, initial=em.Mesh.uniform(em.Grid(n_xi=33, n_eta=33)))


def test_the_second_grid_begins_where_the_first_has_ended() -> None:
    told: list[em.Event] = []
    target = em.Target(error=2e-4)
    u = em.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
    solution = em.solve_to(target, monitor=em.LeastError(u=u), observe=told.append, threads=1)
    first = [event for event in told if event.phase.startswith("grid 1 for the target: ")]
    second = [event.fraction for event in told if event.phase.startswith("grid 2 for the target: ")]
    assert {event.fraction for event in first} == {None}  # how large the second grid is, is not known yet
    known = [share for share in second if share is not None]
    assert known == sorted(known)
    assert known[0] >= 33 * 33 / (33 * 33 + solution.problem.grid.points) / 2
    assert known[-1] > 0.5


def test_blocks_have_no_grid_to_find() -> None:
    corners = {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]}
    blocks = em.Blocks.of({"vertices": corners, "blocks": [{"corners": list("abcd"), "cells": [4, 4]}]})
    with pytest.raises(em.InputError, match="refine the blocks, and solve a Problem of them") as caught:
        em.solve_to(em.Target(error=1e-3), monitor=MONITOR, domain=blocks)  # type: ignore[arg-type]
    assert caught.value.field == "domain"
