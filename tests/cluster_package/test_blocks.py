"""Blocks on the workers of a cluster: the mesh of one process on any number of workers, and what is refused."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from distributed import Client

import equimesh as em
from equimesh.testing.geometries import l_shape, obstacle
from equimesh_cluster import RunCancelledError, solve_blocks

FRONT = em.Expression("tanh(12*((x + 0.2)**2 + (y - 0.1)**2 - 0.5))")
PROBLEM = em.Problem(monitor=em.LeastError(u=FRONT), domain=obstacle(1200))


@pytest.mark.parametrize("parts", [1, 2, None])
def test_the_mesh_does_not_depend_on_the_number_of_workers(client: Client, parts: int | None) -> None:
    alone, told = em.solve(PROBLEM, em.Schwarz()), list[dict[str, Any]]()
    found = solve_blocks(PROBLEM, client, parts=parts, observe=told.append)
    assert np.array_equal(found.mesh.points, alone.mesh.points)
    assert found.status is em.Status.COMPLETED
    assert found.interpolation == alone.interpolation
    assert len(told) == len(found.descent)
    assert told[-1]["error"] == found.descent[-1]["error"]


def test_what_does_not_fit_is_refused_before_the_start(client: Client) -> None:
    corner = em.Problem(monitor=em.LeastError(u=FRONT), domain=l_shape(300))
    with pytest.raises(em.InputError, match="parts = 4: every part needs a subdomain, and there are 3"):
        solve_blocks(corner, client, parts=4)
    with pytest.raises(em.InputError, match="no block outlet"):
        solve_blocks(corner, client, em.Schwarz(groups=[["outlet"]]))
    with pytest.raises(em.InputError, match="no domain in blocks"):
        solve_blocks(em.Problem(monitor=em.LeastError(u=FRONT), grid=em.Grid(n_xi=9, n_eta=9)), client)  # type: ignore[arg-type]


def test_a_cancelled_solve_ends(client: Client) -> None:
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(RunCancelledError):
        solve_blocks(PROBLEM, client, cancel=cancel)
