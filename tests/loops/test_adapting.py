"""Solve, adapt, solve: through a service it is what it is in process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import equimesh as em
import equimesh_client
from equimesh_coupling import element_points

Connect = Callable[..., Any]
SECTOR = (em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0)), equimesh_client.AnnulusSector(angles=(0.0, 60.0)))


CORNER = {"vertices": {"a": [0, 0], "b": [1, 0], "c": [2, 0], "d": [0, 1], "e": [1, 1], "f": [2, 1], "g": [0, 2],
                       "h": [1, 2]},
          "blocks": [{"corners": ["a", "b", "e", "d"], "cells": [9, 9]},
                     {"corners": ["b", "c", "f", "e"], "cells": [9, None]},
                     {"corners": ["d", "e", "h", "g"], "cells": [None, 9]}]}  # fmt: skip


def front(mesh: Any) -> np.ndarray:
    """The nodal values of a solver that makes no error at the nodes."""
    return np.tanh(15.0 * (mesh.x + mesh.y / 2 - 0.75))


def indicator(mesh: Any) -> equimesh_client.ErrorIndicator:
    """An indicator that is large at a front."""
    x, y = (0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]) for q in (mesh.x, mesh.y))
    area = np.abs(np.diff(mesh.x, axis=0)[:, :-1] * np.diff(mesh.y, axis=1)[:-1])
    return equimesh_client.ErrorIndicator(area * (0.01 + np.exp(-50.0 * (x + y - 1.0) ** 2)))


def x_of(mesh: Any) -> np.ndarray:
    """The x coordinates of a mesh whose arrays are fetched."""
    return np.asarray(mesh.x if isinstance(mesh, equimesh_client.Mesh) else mesh._arrays.x)


@pytest.mark.parametrize(("connect", "norm"), [("sync", "h1"), ("async", "l2")], indirect=["connect"])
def test_the_loop_of_the_client_is_that_of_the_solver(connect: Connect, url: str, norm: str) -> None:
    seen: list[int] = []
    there = connect(url).adapt(front, 17, rounds=2, norm=norm, observe=lambda one: seen.append(one.number))
    here = em.adapt(front, 17, rounds=2, norm=norm)
    assert seen == [0, 1, 2]
    assert (there.best, there.resolved, there.reason) == (here.best, here.resolved, here.reason)
    assert np.array_equal(there.values, here.values)
    assert np.array_equal(x_of(there.mesh), here.mesh.x)
    assert there.estimate < 0.5 * there.rounds[0].estimate
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.numbers() == pytest.approx(other.numbers())


@pytest.mark.parametrize("blocks", [None, CORNER], ids=["grid", "blocks"])
def test_the_loop_of_the_client_finds_the_counts_that_the_solver_finds(connect: Connect, url: str, blocks: Any) -> None:
    def level(mesh: Any) -> np.ndarray:
        return np.tanh(4.0 * (mesh.y - 0.3 - 0.1 * mesh.x))

    options: dict[str, Any] = {"points": 256, "rounds": 3}
    here = em.adapt(level, domain=em.Blocks.of(blocks) if blocks else em.Rectangle(), **options)
    there = connect(url).adapt(level, domain=blocks and {"kind": "blocks", **blocks}, **options)
    assert here.rounds[1].mesh.node_shape != here.rounds[0].mesh.node_shape
    assert here.mesh.x.size <= 256
    assert len(there.rounds) == len(here.rounds)
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.numbers() == pytest.approx(other.numbers())
        np.testing.assert_allclose(x_of(one.mesh), other.mesh.x, rtol=0.0, atol=1e-7)


def of_degree(degree: int, cells: Any = "quad") -> Callable[[Any], np.ndarray]:
    """The values of that solver at the nodes of elements of a degree."""

    def values(mesh: Any) -> np.ndarray:
        x, y = element_points(mesh, degree, cells).T
        return np.tanh(15.0 * (x + y / 2 - 0.75))

    return values


SQUARE = {"vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
          "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 4]}]}  # fmt: skip


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_the_loop_of_elements_of_higher_degree_is_that_of_the_solver(connect: Connect, url: str) -> None:
    here, there = em.adapt(of_degree(3), 7, rounds=1, degree=3), connect(url).adapt(of_degree(3), 7, rounds=1, degree=3)
    assert there.values.shape == here.values.shape == (19, 19)
    assert x_of(there.rounds[1].mesh) == pytest.approx(here.rounds[1].mesh.x, abs=1e-12)
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.numbers() == pytest.approx(other.numbers())
    with pytest.raises(equimesh_client.BadValues, match=r"elements of degree 2 have 289 nodes .* of shape \(17, 17\)"):
        connect(url).adapt(front, 9, degree=2)
    with pytest.raises(equimesh_client.BadArgument, match="degree = 5: give 1 to 4"):
        connect(url).adapt(of_degree(2), 9, degree=5)


SIX_NODES: dict[str, Any] = {"rounds": 1, "degree": 2, "cells": "triangle"}


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_the_loop_of_quadratic_triangles_is_that_of_the_solver(connect: Connect, url: str) -> None:
    solve, options = of_degree(2, "triangle"), SIX_NODES
    there, here = connect(url).adapt(solve, 7, **options), em.adapt(solve, 7, **options)
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.numbers() == pytest.approx(other.numbers())
    assert there.values.shape == (13, 13)
    assert x_of(there.rounds[1].mesh) == pytest.approx(here.rounds[1].mesh.x, abs=1e-12)
    with pytest.raises(equimesh_client.BadValues, match=r"2 on triangles have 289 nodes .*, or flat in the order of"):
        connect(url).adapt(front, 9, degree=2, cells="triangle")
    with pytest.raises(equimesh_client.BadArgument, match=r"degree = 3: give 1 to 2, .*on triangles"):
        connect(url).adapt(solve, 9, degree=3, cells="triangle")
    with pytest.raises(equimesh_client.BadArgument, match="cells = 'hexagon': choose 'quad' or 'triangle'"):
        connect(url).adapt(solve, 9, cells="hexagon")


@pytest.mark.parametrize("connect", ["async"], indirect=True)
@pytest.mark.parametrize(
    ("solve", "options"),
    [(of_degree(4), {"rounds": 1, "degree": 4}), (of_degree(2, "triangle"), SIX_NODES)],
    ids=["degree 4", "quadratic triangles"],
)
def test_the_loop_on_blocks_is_that_of_the_solver(
    connect: Connect, url: str, solve: Callable[[Any], np.ndarray], options: dict[str, Any]
) -> None:
    here = em.adapt(solve, domain=em.Blocks.of(SQUARE), **options)
    there = connect(url).adapt(solve, domain={"kind": "blocks", **SQUARE}, **options)
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.numbers() == pytest.approx(other.numbers())


def test_the_loop_on_a_sector(connect: Connect, url: str) -> None:
    here, there = SECTOR

    def ring(mesh: Any) -> np.ndarray:
        return np.tanh(20.0 * (np.hypot(mesh.x, mesh.y) - 1.5))

    found = connect(url).adapt(ring, (17, 9), domain=there, rounds=1)
    expected = em.adapt(ring, (17, 9), domain=here, rounds=1)
    assert x_of(found.mesh) == pytest.approx(expected.mesh.x, abs=1e-12)
    assert found.estimate == pytest.approx(expected.estimate, rel=1e-9)


def test_an_indicator_leads_the_loop_as_well(connect: Connect, url: str) -> None:
    found = connect(url).adapt(indicator, 17, rounds=2)
    expected = em.adapt(indicator, 17, rounds=2)
    assert found.rounds[1].start == "weight"
    assert x_of(found.rounds[1].mesh) == pytest.approx(expected.rounds[1].mesh.x, abs=1e-6)
    assert found.rounds[1].moved_cells == pytest.approx(expected.rounds[1].moved_cells, rel=1e-6)
    assert [one.estimate for one in found.rounds] == pytest.approx([one.estimate for one in expected.rounds], rel=1e-5)


def test_a_solver_that_fails_later_keeps_the_best_mesh(connect: Connect, url: str) -> None:
    calls: list[Any] = []

    def diverges(mesh: Any) -> np.ndarray:
        calls.append(mesh)
        return front(mesh) if len(calls) < 3 else np.full(mesh.x.shape, np.nan)

    found = connect(url).adapt(diverges, 9)
    assert (len(found.rounds), found.best) == (2, 1)
    assert isinstance(found.failure, equimesh_client.BadValues)
    assert found.reason.startswith("Round 2 failed, and the best mesh before it is kept: BadValues")


GOAL = em.Goal.point(0.3, 0.4, diffusion=1.0, reaction=1.0, source=1.0)


def with_adjoint(mesh: Any) -> em.WithAdjoint:
    """A solver whose adjoint is a bump."""
    return em.WithAdjoint(front(mesh), np.exp(-20.0 * ((mesh.x - 0.3) ** 2 + (mesh.y - 0.4) ** 2)))


@pytest.mark.parametrize("blocks", [None, SQUARE], ids=["grid", "blocks"])
def test_the_loop_for_a_goal_is_that_of_the_solver(connect: Connect, url: str, blocks: Any) -> None:
    n = 9 if blocks is None else None
    here = em.adapt(with_adjoint, n, rounds=1, goal=GOAL, domain=em.Blocks.of(blocks) if blocks else em.Rectangle())
    there = connect(url).adapt(with_adjoint, n, rounds=1, goal=GOAL, domain=blocks and {"kind": "blocks", **blocks})
    assert x_of(there.rounds[1].mesh) == pytest.approx(here.rounds[1].mesh.x, abs=1e-9)
    assert here.rounds[1].moved_cells > 0.05
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.numbers() == pytest.approx(other.numbers())
        assert one.goal is not None
        assert one.goal.error is not None
    with pytest.raises(equimesh_client.BadArgument, match="give the goal, too"):
        connect(url).adapt(front, 9, tolerance=1e-3)
    with pytest.raises(equimesh_client.BadValues, match="an adjoint needs a goal"):
        connect(url).adapt(with_adjoint, 9)


def test_what_is_refused(connect: Connect, url: str) -> None:
    client = connect(url)
    with pytest.raises(equimesh_client.BadValues, match="one for each cell"):
        client.adapt(lambda mesh: np.ones(mesh.x.size - 17), 9)
    with pytest.raises(equimesh_client.BadArgument, match="rounds = 0"):
        client.adapt(front, 9, rounds=0)
    with pytest.raises(equimesh_client.BadArgument, match="norm = 'l3'"):
        client.adapt(front, 9, norm="l3")


def test_a_linear_solution_ends_at_once(connect: Connect, url: str) -> None:
    found = connect(url).adapt(lambda mesh: mesh.x - 2.0 * mesh.y, 9)
    assert found.reason == "The estimated error is zero: the elements have the solution exactly."
    assert len(found.rounds) == 1
