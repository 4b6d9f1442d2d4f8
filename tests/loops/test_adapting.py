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


def of_degree(degree: int, cells: Any = "quad") -> Callable[[Any], np.ndarray]:
    """The values of that solver at the nodes of elements of a degree."""

    def values(mesh: Any) -> np.ndarray:
        x, y = element_points(mesh, degree, cells).T
        return np.tanh(15.0 * (x + y / 2 - 0.75))

    return values


SQUARE = {"vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
          "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 4]}]}  # fmt: skip
BLOCKS = (em.Blocks.of(SQUARE), {"kind": "blocks", **SQUARE})
SIX_NODES: dict[str, Any] = {"degree": 2, "cells": "triangle"}
GOAL = em.Goal.point(0.3, 0.4, diffusion=1.0, reaction=1.0, source=1.0)


def with_adjoint(mesh: Any) -> em.WithAdjoint:
    """A solver whose adjoint is a bump."""
    return em.WithAdjoint(front(mesh), np.exp(-20.0 * ((mesh.x - 0.3) ** 2 + (mesh.y - 0.4) ** 2)))


# What a solver returns, the arguments of both loops, and the domain of each.
LOOPS: dict[str, tuple[Callable[[Any], Any], dict[str, Any], tuple[Any, Any] | None]] = {
    "values": (front, {"n": 17, "rounds": 2, "norm": "h1"}, None),
    "quadratic triangles": (of_degree(2, "triangle"), {"n": 7, **SIX_NODES}, None),
    "degree 3 on blocks": (of_degree(3), {"degree": 3}, BLOCKS),
    "quadratic triangles on blocks": (of_degree(2, "triangle"), SIX_NODES, BLOCKS),
    "an indicator": (indicator, {"n": 17}, None),
    "a goal": (with_adjoint, {"n": 9, "goal": GOAL}, None),
    "a goal on blocks": (with_adjoint, {"goal": GOAL}, BLOCKS),
}


@pytest.mark.parametrize("connect", ["async"], indirect=True)
@pytest.mark.parametrize("name", LOOPS)
def test_the_loop_of_the_client_is_that_of_the_solver(connect: Connect, url: str, name: str) -> None:
    solve, given, domains = LOOPS[name]
    options, seen = {"rounds": 1, **given}, list[int]()
    of_solver, of_client = ({"domain": domain} for domain in domains) if domains else ({}, {})
    here = em.adapt(solve, **options, **of_solver)
    there = connect(url).adapt(solve, **options, **of_client, observe=lambda one: seen.append(one.number))
    assert seen == [*range(options["rounds"] + 1)]
    assert (there.best, there.resolved, there.reason) == (here.best, here.resolved, here.reason)
    assert there.values == pytest.approx(here.values)
    assert x_of(there.rounds[-1].mesh) == pytest.approx(here.rounds[-1].mesh.x, abs=1e-6)
    assert there.rounds[-1].start == ("weight" if solve is indicator else here.rounds[-1].start)
    for one, other in zip(there.rounds, here.rounds, strict=True):
        assert one.estimate == pytest.approx(other.estimate, rel=1e-5)
        assert solve is indicator or one.numbers() == pytest.approx(other.numbers())  # rounding moves its mesh more
        assert (one.goal is None) == ("goal" not in options)


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
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


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_the_first_grid_of_a_number_of_points_has_the_shape_of_the_domain(connect: Connect, url: str) -> None:
    seen = list[tuple[int, ...]]()

    def solve(mesh: Any) -> np.ndarray:
        seen.append(x_of(mesh).shape)
        return front(mesh)

    long = {"kind": "rectangle", "x": [0, 4], "y": [0, 1]}
    connect(url).adapt(solve, domain=long, points=256, rounds=1)
    here = em.adapt(front, domain=em.Rectangle(x=(0, 4)), points=256, rounds=1)
    assert seen[0] == here.rounds[0].mesh.grid.shape == (32, 8)


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_a_solver_that_fails_later_keeps_the_best_mesh(connect: Connect, url: str) -> None:
    calls: list[Any] = []

    def diverges(mesh: Any) -> np.ndarray:
        calls.append(mesh)
        return front(mesh) if len(calls) < 3 else np.full(mesh.x.shape, np.nan)

    found = connect(url).adapt(diverges, 9)
    assert (len(found.rounds), found.best) == (2, 1)
    assert isinstance(found.failure, equimesh_client.BadValues)
    assert found.reason.startswith("Round 2 failed, and the best mesh before it is kept: BadValues")


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_what_is_refused(connect: Connect, url: str) -> None:
    client, nodes = connect(url), equimesh_client.BadValues
    with pytest.raises(nodes, match="one for each cell"):
        client.adapt(lambda mesh: np.ones(mesh.x.size - 17), 9)
    with pytest.raises(nodes, match=r"elements of degree 2 have 289 nodes .* of shape \(17, 17\)"):
        client.adapt(front, 9, degree=2)
    with pytest.raises(nodes, match=r"2 on triangles have 289 nodes .*, or flat in the order of"):
        client.adapt(front, 9, degree=2, cells="triangle")
    with pytest.raises(nodes, match="indicator"):
        client.adapt(lambda _: equimesh_client.ErrorIndicator(np.ones(16)), domain=BLOCKS[1])
    with pytest.raises(equimesh_client.BadArgument, match="leave n out for its own"):
        client.adapt(front, 17, domain=BLOCKS[1])
    with pytest.raises(equimesh_client.BadArgument, match="n is missing"):
        client.adapt(front)
    with pytest.raises(nodes, match="an adjoint needs a goal"):
        client.adapt(with_adjoint, 9)
    for options, words in (
        ({"rounds": 0}, "rounds = 0"),
        ({"norm": "l3"}, "norm = 'l3'"),
        ({"degree": 5}, "degree = 5: give 1 to 4"),
        ({"degree": 3, "cells": "triangle"}, r"degree = 3: give 1 to 2, .*on triangles"),
        ({"cells": "hexagon"}, "cells = 'hexagon': choose 'quad' or 'triangle'"),
        ({"tolerance": 1e-3}, "give the goal, too"),
        ({"goal": GOAL, "norm": "h1"}, "leave norm out"),
    ):
        with pytest.raises(equimesh_client.BadArgument, match=words):
            client.adapt(front, 9, **options)


@pytest.mark.parametrize("connect", ["sync"], indirect=True)
def test_a_linear_solution_ends_at_once(connect: Connect, url: str) -> None:
    found = connect(url).adapt(lambda mesh: mesh.x - 2.0 * mesh.y, 9)
    assert found.reason == "The estimated error is zero: the elements have the solution exactly."
    assert len(found.rounds) == 1
