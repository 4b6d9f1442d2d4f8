"""Invariants: what holds for every mesh, whatever the function."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest

import equimesh as em
from cases import FUNCTIONS, problem

BOUNDARIES = list(em.Boundary)


def mesh_of(u: str, n_xi: int, n_eta: int, boundary: em.Boundary = em.Boundary.TRACE) -> em.Mesh:
    monitor = em.ArcLength(u=em.Expression(u), scaled=False)
    return em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n_xi, n_eta=n_eta), boundary=boundary)).mesh


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return max(abs(one.x - other.x).max(), abs(one.y - other.y).max())


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("u", ["3", "0*x", "2*x - 5*y"])
def test_a_constant_metric_gives_the_uniform_mesh(u: str, boundary: em.Boundary) -> None:
    mesh = mesh_of(u, 11, 8, boundary)
    assert distance(mesh, em.Mesh.uniform(mesh.grid)) < 1e-13


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_symmetries_of_the_square(boundary: em.Boundary) -> None:
    mesh = mesh_of("tanh(8*(x + y/2 - 0.75))", 13, 10, boundary)
    mirrored = mesh_of("tanh(8*(1 - x + y/2 - 0.75))", 13, 10, boundary)
    assert distance(em.Mesh(1 - mirrored.x[::-1], mirrored.y[::-1]), mesh) < 1e-12
    upside_down = mesh_of("tanh(8*(x + (1 - y)/2 - 0.75))", 13, 10, boundary)
    assert distance(em.Mesh(upside_down.x[:, ::-1], 1 - upside_down.y[:, ::-1]), mesh) < 1e-12
    turned = mesh_of("tanh(8*(y + x/2 - 0.75))", 10, 13, boundary)
    assert distance(em.Mesh(turned.y.T, turned.x.T), mesh) < 1e-12


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("name", ["paper", "ring", "gauss", "tanh20"])
def test_interior_equations_hold_on_the_mesh(name: str, boundary: em.Boundary) -> None:
    """Metric lengths are equal along every line: c1 along xi, c2 along eta, by a computation of their own."""
    case = problem(name, 17, 14, boundary=boundary)
    mesh = em.solve(case).mesh
    squared = squared_lengths(case, mesh)
    for lengths in squared:
        assert np.ptp(lengths, axis=0).max() < 1e-10 * lengths.mean()
    assert np.ptp(squared[0], axis=1).max() > 0.01 * squared[0].mean()  # c1 does differ from line to line


def squared_lengths(case: em.Problem, mesh: em.Mesh) -> list[np.ndarray]:
    """S1^2 on the xi-edges and S2^2 on the eta-edges of interior lines, cell by cell from the definition."""
    (u,) = case.monitor.u.evaluate(mesh.x, mesh.y)
    result = []
    for x, y, q in ((mesh.x, mesh.y, u), (mesh.x.T, mesh.y.T, u.T)):
        n, m = x.shape
        metric = np.empty((n - 1, m - 1, 2, 2))
        for i, j in itertools.product(range(n - 1), range(m - 1)):
            across = [(p[i + 1, j + 1] + p[i + 1, j] - p[i, j + 1] - p[i, j]) / 2 for p in (x, y, q)]
            along = [(p[i + 1, j + 1] + p[i, j + 1] - p[i + 1, j] - p[i, j]) / 2 for p in (x, y, q)]
            w = np.linalg.solve([across[:2], along[:2]], [across[2], along[2]])
            k = case.monitor.a**2 / (1 + case.monitor.b * w @ w)
            metric[i, j] = k * np.outer(w, w) + np.eye(2)
        edges = np.stack([np.diff(x, axis=0), np.diff(y, axis=0)], axis=-1)[:, 1:-1] * (n - 1)
        mean = (metric[:, 1:] + metric[:, :-1]) / 2
        result.append(np.einsum("ija,ijab,ijb->ij", edges, mean, edges))
    return result


PARTITIONS = [(2, 1), (1, 2), (3, 1), (2, 2)]
# Functions on which each condition converges with p = auto by itself, for every partition and ordering below.
CONVERGES = {
    "classical": FUNCTIONS["tanh20"],
    "linear_robin": "tanh(4*(x + y/2 - 0.75))",
    "nonlinear_robin": FUNCTIONS["paper"],
}


CONDITIONS = [em.Classical(), em.LinearRobin(), em.NonlinearRobin()]


def combinations() -> Iterator[pytest.ParameterSet]:
    """All of them, marked ``everything`` but for 16 in which any two choices meet: any ordering any boundary, ..."""
    sizes = (len(CONDITIONS), len(PARTITIONS), len(BOUNDARIES), len(em.Ordering))
    for c, p, b, o in itertools.product(*map(range, sizes)):
        chosen = (CONDITIONS[c], PARTITIONS[p], BOUNDARIES[b], list(em.Ordering)[o])
        pairs = c == (o + p) % 3 and b == (o + 2 * p) % 3
        name = "-".join([CONDITIONS[c].name, *map(str, chosen[1:])])
        yield pytest.param(*chosen, id=name, marks=() if pairs else pytest.mark.everything)


@pytest.mark.parametrize(("condition", "partition", "boundary", "ordering"), list(combinations()))
def test_the_schwarz_limit_is_the_single_domain_mesh(
    condition: em.TransmissionCondition, partition: tuple[int, int], boundary: em.Boundary, ordering: em.Ordering
) -> None:
    monitor = em.ArcLength(u=em.Expression(CONVERGES[condition.name]), scaled=False)
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=12, n_eta=11), boundary=boundary)
    settings = em.Schwarz(
        subdomains=partition, overlap=4, transmission=condition, ordering=ordering, tolerance=1e-11, max_iterations=150
    )
    solution = em.solve(case, settings)
    assert distance(solution.mesh, em.solve(case).mesh) < 1e-9
    assert not any(r.classical or r.stalled for record in solution.iterations for r in record.subdomains)
