"""What is refused where lines are closed, and what a solve returns there."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.io import write_mesh
from equimesh.io.reading.read import read_mesh
from equimesh.least_error.iteration import LeastErrorSolve

GRID = em.Grid(n_xi=17, n_eta=17)
U = em.Expression("tanh(2*(sin(2*pi*x)*cos(2*pi*y)-0.2))")
DOMAIN = em.Rectangle(periodic="x")
UNIFORM = em.Mesh.uniform(GRID)


@pytest.mark.parametrize(
    ("monitor", "schwarz", "field", "reason"),
    [
        (em.ArcLength(u=U), em.Schwarz(subdomains=(2, 1)), "schwarz", "the subdomains of a Schwarz iteration end"),
        (em.Weight(rho=em.Expression("1+y"), map="gradient"), None, "monitor.map", "take map = 'lines'"),
        (
            em.NodalSolution(u=em.NodalField(mesh=UNIFORM, values=np.sin(2 * np.pi * UNIFORM.x))),
            None,
            "monitor",
            "slopes are recovered from the values at nodes on four sides",
        ),
    ],
)
def test_what_needs_four_sides_is_refused(monitor: Any, schwarz: Any, field: str, reason: str) -> None:
    with pytest.raises(em.InputError, match=reason) as error:
        em.solve(em.Problem(monitor=monitor, grid=GRID, domain=DOMAIN), schwarz)
    assert error.value.field == field


MONITORS = {
    "arc length": em.ArcLength(u=U),
    "smoothed curvature": em.Smoothed(monitor=em.Curvature(u=U), radius=0.1),
    "weight": em.Weight(rho=em.Expression("1.5+sin(2*pi*x)*y")),
    "tensor": em.Tensor(m11=em.Expression("2+cos(2*pi*x)"), m12=em.Expression("0"), m22=em.Expression("1+y")),
    "intersection": em.Intersection(monitors=(em.ArcLength(u=U), em.Weight(rho=em.Expression("1+y")))),
}


@pytest.mark.parametrize("name", MONITORS)
def test_every_monitor_has_a_certified_mesh(name: str) -> None:
    solution = em.solve(em.Problem(monitor=MONITORS[name], grid=GRID, domain=DOMAIN), mode="tight")
    assert solution.status is em.Status.CONVERGED
    residual = solution.certificate.equation_residual
    assert residual is not None
    assert residual < 1e-11
    assert np.array_equal(solution.mesh.x[-1], solution.mesh.x[0] + 1.0)


def test_a_start_must_be_closed() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=U), grid=GRID, domain=DOMAIN)
    found = em.solve(problem)
    again = em.solve(problem, initial=found.reference)
    assert again.mesh.distance(found.mesh) < 1e-3
    broken = em.Mesh(found.reference.x.copy(), found.reference.y.copy())
    broken.x[0, 3] += 1e-3
    with pytest.raises(em.InputError, match="valid one of the reference square"):
        em.solve(problem, initial=broken)


def least(domain: em.Domain, u: str, grid: em.Grid = GRID, **options: Any) -> em.Solution:
    return em.solve(em.Problem(monitor=em.LeastError(u=em.Expression(u), **options), grid=grid, domain=domain))


@pytest.mark.parametrize("options", [{}, {"cells": "triangle"}, {"norm": "h1"}, {"rectilinear": True}])
def test_least_error_bends_the_seam_and_gains(options: dict[str, Any]) -> None:
    solution = least(em.Rectangle(periodic="both"), "tanh(8*(sin(2*pi*(x+0.1))*cos(2*pi*y)-0.2))", **options)
    errors = solution.interpolation
    assert errors is not None
    assert errors.l2_uniform / errors.l2 > (1.1 if options.get("rectilinear") else 3.0)
    assert not solution.mesh.is_folded
    assert np.array_equal(solution.mesh.x[-1], solution.mesh.x[0] + 1.0)
    assert np.array_equal(solution.mesh.y[:, -1], solution.mesh.y[:, 0] + 1.0)
    if not options.get("rectilinear"):
        assert np.ptp(solution.mesh.x[0]) > 1e-3


def test_steps_of_least_error_do_not_depend_on_where_lines_begin() -> None:
    """Later steps do, by rounding: a descent doubles every difference within a step or two."""
    grid, ring = em.Grid(n_xi=9, n_eta=9), em.AnnulusSector(closed=True)
    u = [em.Expression("tanh(4*(x-0.3))"), em.Expression("tanh(4*(y-0.3))")]  # turned by a quarter: 2 of 8 cells
    for uniform_only in (True, False):
        ways = [
            LeastErrorSolve(monitor=em.LeastError(u=one).on(ring), domain=ring, grid=grid).steps(
                uniform_only=uniform_only
            )
            for one in u
        ]
        for one, other in islice(zip(*ways, strict=False), 8):
            assert np.abs(np.roll(one.mesh.x[:, :-1], 2, 1) - other.mesh.x[:, :-1]).max() < 1e-12
            moved = np.roll(one.mesh.y[:, :-1], 2, 1) + 0.25 - other.mesh.y[:, :-1]
            assert np.abs((moved + 0.5) % 1.0 - 0.5).max() < 1e-12


def test_values_at_the_nodes_of_a_bent_mesh_are_a_function_of_the_whole_plane() -> None:
    bent = least(DOMAIN, "tanh(4*(y-0.5-0.2*sin(2*pi*x)))").mesh
    assert np.ptp(bent.x[0]) > 1e-3
    values = np.sin(2 * np.pi * bent.x) * bent.y
    monitor = em.ArcLength(u=em.NodalField(mesh=bent, values=values))
    solution = em.solve(em.Problem(monitor=monitor, grid=GRID, domain=DOMAIN))
    found = em.solve(em.Problem(monitor=em.ArcLength(u=em.Expression("sin(2*pi*x)*y")), grid=GRID, domain=DOMAIN))
    assert solution.mesh.distance(found.mesh) < 0.01


def test_least_error_continues_from_a_given_mesh() -> None:
    u = em.Expression("tanh(8*(y-0.5-0.2*sin(2*pi*x)))")
    problem = em.Problem(monitor=em.LeastError(u=u), grid=GRID, domain=DOMAIN)
    found = em.solve(problem)
    again = em.solve(problem, initial=found.reference)
    assert found.interpolation is not None
    assert again.interpolation is not None
    assert again.interpolation.l2 <= found.interpolation.l2


def test_the_best_monitor_is_chosen_on_closed_lines() -> None:
    u = em.Expression("tanh(8*(y-0.5-0.2*sin(2*pi*x)))")
    solution = em.solve(em.Problem(monitor=em.Auto(u=u), grid=GRID, domain=DOMAIN))
    errors = solution.interpolation
    assert errors is not None
    assert errors.l2_uniform / errors.l2 > 3.0
    assert solution.comparison


@pytest.mark.parametrize("suffix", ["msh", "vtu", "su2", "npz"])
def test_files_with_and_without_the_seam(suffix: str, tmp_path: Path) -> None:
    solution = least(em.AnnulusSector(closed=True), "tanh(4*(x-0.3))", em.Grid(n_xi=9, n_eta=17))
    data = solution.data(joined=True)
    assert len(data.mesh.points) == 9 * 16
    assert data.u is not None
    assert np.array_equal(data.u, np.tanh(4 * (data.mesh.points[:, 0] - 0.3)))
    for name, contents, nodes in (("one", data, 9 * 16), ("two", solution.data(), 9 * 17)):
        path = tmp_path / f"{name}.{suffix}"
        write_mesh(path, contents)
        if suffix != "npz":
            assert len(read_mesh(path).points) == nodes
        else:
            assert np.load(path)["x"].size == nodes


def test_a_front_is_followed_across_the_seam() -> None:
    def moved(t: float) -> em.Expression:
        return em.Expression(f"tanh(8*(sin(2*pi*(x-{t}))-0.4))")

    sequence = em.Sequence(em.Problem(monitor=em.LeastError(u=moved(0.2)), grid=GRID, domain=DOMAIN))
    for k in range(1, 4):
        step = sequence.step(moved(0.2 + 0.05 * k))
    errors = step.solution.interpolation
    assert errors is not None
    assert errors.l2_uniform / errors.l2 > 3.0
