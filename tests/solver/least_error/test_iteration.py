"""The whole way to a mesh of least error, with its records."""

from __future__ import annotations

from itertools import groupby, pairwise
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.nest import nested_levels
from equimesh.least_error.starts import mesh_of, product, rectilinear
from equimesh.quality.measures import measure_errors
from solver.bent import DOMAINS

FRONT = em.Expression("tanh(40*(x + y/2 - 0.75))")
LAYERS = em.Expression("exp(-x/0.01) + exp((y - 1)/0.01)")


def records(
    u: em.Field,
    n_xi: int,
    n_eta: int,
    domain: em.Domain = DOMAINS["square"],
    start: em.Mesh | None = None,
    **asked: Any,
) -> list[Descent]:
    options = {name: asked.pop(name) for name in ("uniform_only",) if name in asked}
    threads = asked.pop("threads", 1)
    monitor = em.LeastError(u=u, **asked).on(domain)
    solve = LeastErrorSolve(monitor=monitor, domain=domain, grid=em.Grid(n_xi=n_xi, n_eta=n_eta), threads=threads)
    return list(solve.steps(start, **options))


def gain(mesh: em.Mesh, u: em.Field, domain: em.Domain, norm: str = "l2") -> float:
    """How many times smaller the error is than on the uniform mesh, by the rule of the certificate."""
    errors = measure_errors(map_mesh(mesh, domain), u, uniform=map_mesh(em.Mesh.uniform(mesh.grid), domain))
    return errors.gain_l2 if norm == "l2" else errors.gain_h1


@pytest.mark.parametrize("u", [FRONT, LAYERS], ids=["front", "layers"])
def test_the_last_record_is_the_best_mesh_of_the_grid(u: em.Expression) -> None:
    found = records(u, 33, 25)
    last = found[-1]
    assert last.grid.shape == (33, 25)
    assert last.level + 1 == last.levels
    assert last.gain > 4.0
    assert last.gain == pytest.approx(gain(last.mesh, u, DOMAINS["square"]), rel=0.15)


def test_records_follow_each_other_and_none_occurs_twice() -> None:
    found = records(LAYERS, 33, 25)
    assert {one.start for one in found} == {"uniform", "rectilinear"}
    for (start, _level), group in groupby(found, key=lambda one: (one.start, one.level)):
        steps = [*group]
        assert [one.step for one in steps] == list(range(len(steps)))
        assert len(steps) <= steps[0].steps + 1
        levels = nested_levels(em.Grid(n_xi=33, n_eta=25))
        assert steps[0].grid == levels[steps[0].level].grid, start
    for one in found:
        assert one.min_jacobian == pytest.approx(one.mesh.min_jacobian, rel=1e-9)
        assert one.distortion >= -1e-12
        assert one.error > 0.0
    assert all(one is not other for one, other in pairwise(found))


def test_the_number_of_steps_is_what_it_was() -> None:
    counts = {
        name: len(records(em.Expression(u), 33, 33))
        for name, u in {
            "ring": "tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))",
            "sine": "sin(2*pi*x)*sin(2*pi*y)",
            "layers": LAYERS.text,
        }.items()
    }
    assert all(10 <= count <= 180 for count in counts.values()), counts


@pytest.mark.parametrize("shape", [(4, 4), (4, 9), (5, 5), (9, 9), (12, 17), (17, 17), (5, 40), (40, 6)])
def test_small_and_uneven_grids_are_never_worse_and_never_folded(shape: tuple[int, int]) -> None:
    for u in (FRONT, LAYERS):
        last = records(u, *shape)[-1]
        assert last.grid.shape == shape
        assert not last.mesh.is_folded
        assert last.gain >= 1.0


def test_threads_do_not_change_the_mesh() -> None:
    one, two = (records(FRONT, 70, 66, threads=threads)[-1].mesh for threads in (1, 2))
    assert np.array_equal(one.x, two.x)
    assert np.array_equal(one.y, two.y)


def test_a_start_from_the_uniform_mesh_alone_tries_nothing_else() -> None:
    assert {one.start for one in records(LAYERS, 17, 17, uniform_only=True)} == {"uniform"}


def test_layers_begin_rectilinear_and_gain_much() -> None:
    found = records(em.Expression("exp(-x/0.001) + exp(-y/0.001)"), 33, 33)
    assert found[-1].start == "rectilinear"
    assert found[-1].gain > 50.0


@pytest.mark.parametrize("u", ["3", "2*x - 3*y + 1", "x*y"])
def test_what_is_met_exactly_leaves_the_mesh_uniform(u: str) -> None:
    found = records(em.Expression(u), 17, 17)
    assert found[-1].mesh.distance(em.Mesh.uniform(found[-1].grid)) == 0.0
    assert {one.start for one in found} == {"uniform"}
    assert found[-1].gain == 1.0


def test_the_weights_trade_error_for_shape() -> None:
    loose, usual, smooth = (
        records(FRONT, 33, 33, distortion=d, smoothness=s)[-1] for d, s in ((0.1, 0.1), (0.5, 1.0), (3.0, 20.0))
    )
    assert loose.error < usual.error < smooth.error
    assert smooth.min_jacobian > usual.min_jacobian


@pytest.mark.parametrize(
    ("u", "norm"), [("sqrt(x*y)", "l2"), ("(x**2 + y**2)**(1/3)", "l2"), ("(x**2 + y**2)**(1/3)", "h1")]
)
def test_infinite_slopes_at_a_side_are_met(u: str, norm: str) -> None:
    with np.errstate(all="ignore"):
        assert records(em.Expression(u), 17, 17, norm=norm)[-1].gain > 2.0


@pytest.mark.parametrize(("norm", "n"), [("l2", 65), ("h1", 33), ("h1", 40)])
def test_upright_fronts_are_met_as_well_as_by_straight_lines(norm: str, n: int) -> None:
    u = em.Expression("tanh(60*(x - 0.37))")
    last = records(u, n, n, norm=norm)[-1]
    found = rectilinear(u, DOMAINS["square"], (n, n), norm, 0.1)  # type: ignore[arg-type]
    assert found is not None
    straight = mesh_of(product(*found), last.grid)
    assert gain(last.mesh, u, DOMAINS["square"], norm) > 0.95 * gain(straight, u, DOMAINS["square"], norm) > 5.0


@pytest.mark.parametrize(
    ("u", "largest"),
    [
        ("exp(-x/0.01) + exp((y - 1)/0.01)", 1e-6),
        ("tanh(15*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", 1e-6),
        # Rounding grows in the long descent to an oblique or bent front.
        ("tanh(30*(y - 0.5 - 0.25*sin(2*pi*x)))", 1e-3),
    ],
    ids=["layers", "ring", "wave"],
)
def test_a_square_as_one_block_is_the_grid(u: str, largest: float) -> None:
    n = 33
    monitor = em.LeastError(u=em.Expression(u))
    corners = {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]}
    block = em.Blocks.of({"vertices": corners, "blocks": [{"corners": [*corners], "cells": [n - 1, n - 1]}]})
    grid, blocks = (
        em.solve(problem, threads=1).interpolation
        for problem in (
            em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n)),
            em.Problem(monitor=monitor, domain=block),
        )
    )
    assert blocks.gain_l2 == pytest.approx(grid.gain_l2, rel=largest)
