"""What is refused where lines are closed, and what a solve returns there."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.io import write_mesh
from equimesh.io.npz import load_npz
from equimesh.io.reading.read import read_mesh
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.quality.faces import measure_faces

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
    assert again.interpolation.l2 <= found.interpolation.l2


def test_the_best_monitor_is_chosen_on_closed_lines() -> None:
    u = em.Expression("tanh(8*(y-0.5-0.2*sin(2*pi*x)))")
    solution = em.solve(em.Problem(monitor=em.Auto(u=u), grid=GRID, domain=DOMAIN))
    assert solution.solver_gain.l2 > 2.5
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
        if suffix != "npz":  # solvers want no second copies of nodes
            found = read_mesh(path)
            assert len(found.points) == 9 * 16
            assert {*found.sides} == {"left", "right"}
        else:
            assert np.load(path)["x"].size == nodes
    kept = load_npz(tmp_path / "two.npz") if suffix == "npz" else solution.data()
    assert np.array_equal(kept.mesh.ties, solution.ties)
    assert np.array_equal(kept.joined.mesh.points, data.mesh.points)


@pytest.mark.parametrize("periodic", ["x", "y", "both"])
def test_files_name_the_pair_of_periodic_sides(periodic: Any, tmp_path: Path) -> None:
    solution = least(em.Rectangle(x=(0.0, 2.0), periodic=periodic), "sin(pi*x)*sin(2*pi*y)", em.Grid(n_xi=9, n_eta=7))
    pairs = {"x": [("left", "right", (2.0, 0.0, 0.0))], "y": [("bottom", "top", (0.0, 1.0, 0.0))]}
    named = [*pairs["x"], *pairs["y"]] if periodic == "both" else pairs[periodic]
    (tmp_path / "case").mkdir()
    write_mesh(tmp_path / "case", solution.data())
    text = (tmp_path / "case/constant/polyMesh/boundary").read_text()
    assert text.count("type cyclic;") == 2 * len(named)
    for one, other, way in named:
        entry = text.split(f"\n{one}\n")[1].split("}")[0]
        assert f"neighbourPatch {other};" in entry
        vector = entry.split("separationVector (")[1].split(")")[0]
        assert [float(word) for word in vector.split()] == pytest.approx(way, abs=1e-12)
    write_mesh(tmp_path / "mesh.msh", solution.data())
    section = (tmp_path / "mesh.msh").read_text().split("$Periodic\n")[1].splitlines()
    assert int(section[0]) == len(named)


@pytest.mark.parametrize("periodic", ["x", "y", "both", None])
def test_faces_and_sizes_are_measured_across_the_seam(periodic: Any) -> None:
    domain = em.AnnulusSector(closed=True) if periodic is None else em.Rectangle(periodic=periodic)
    u = "tanh(4*(x-0.3))" if periodic is None else "tanh(8*(sin(2*pi*(x+0.1))*cos(2*pi*y)-0.2))"
    solution = least(domain, u, em.Grid(n_xi=9, n_eta=13))
    expected = measure_faces(solution.joined)
    assert solution.faces.summary() == pytest.approx(expected.summary(), rel=1e-9)
    assert solution.faces.skewness == pytest.approx(expected.skewness, rel=1e-9)
    assert solution.faces.summary() != pytest.approx(measure_faces(solution.mesh).summary(), rel=1e-6)
    sizes = em.measure(solution.joined, solution.problem.monitor).size_ratio
    assert solution.quality.size_ratio.cells.ravel() == pytest.approx(sizes.cells, rel=1e-12)
    cut = em.measure(solution.mesh, solution.problem.monitor).size_ratio
    assert (cut.cells.ravel() <= sizes.cells * (1.0 + 1e-12)).all()
    assert cut.mean < sizes.mean or periodic in ("y", None)


@pytest.mark.parametrize("domain", [DOMAIN, em.Rectangle(periodic="both"), em.AnnulusSector(closed=True)])
def test_fields_are_carried_across_the_seam(domain: em.Domain) -> None:
    turns = ["sin(2*pi*(x-0.1))+0*y", "sin(2*pi*(x-0.3))+0*y"]
    if domain.area != 1.0:
        turns = ["tanh(3*(x-0.3))", "tanh(3*(y-0.3))"]
    monitor = em.ArcLength(u=em.Expression(turns[0]))
    sequence = em.Sequence(em.Problem(monitor=monitor, grid=GRID, domain=domain))
    sequence.step(em.Expression(turns[0]))
    before = sequence.mesh
    u = np.cos(2 * np.pi * before.x) if domain.area == 1.0 else before.x * before.y
    averages = np.arange(256.0).reshape(16, 16)
    vector = np.stack([u, 2.0 * u], axis=2)
    fields: dict[str, Any] = {
        "smooth": u,
        "vector": vector,
        "kept": em.MeshValues(u, transfer="conservative"),
        "averages": em.MeshValues(averages, transfer="conservative", location="cells"),
    }
    step = sequence.step(em.Expression(turns[1]), fields)
    after = step.mesh
    expected = np.cos(2 * np.pi * after.x) if domain.area == 1.0 else after.x * after.y
    assert np.abs(after.points - before.points).max() > 0.02
    assert np.abs(step.fields["smooth"] - expected).max() < 0.1
    assert np.array_equal(step.fields["vector"][:, :, 1], 2.0 * step.fields["vector"][:, :, 0])
    assert step.fields["averages"].shape == (16, 16)
    copies, originals = step.solution.ties.T
    for name in ("smooth", "kept"):
        values = step.fields[name].ravel()
        assert values[copies] == pytest.approx(values[originals], abs=1e-12), name
    for name, kept in (("averages", averages), ("kept", u)):
        where = "cells" if name == "averages" else "nodes"
        there, here = em.integral(after, step.fields[name], where), em.integral(before, kept, where)
        assert there == pytest.approx(here, rel=1e-9, abs=1e-12), name


def test_a_front_is_followed_across_the_seam() -> None:
    def moved(t: float) -> em.Expression:
        return em.Expression(f"tanh(8*(sin(2*pi*(x-{t}))-0.4))")

    sequence = em.Sequence(em.Problem(monitor=em.LeastError(u=moved(0.2)), grid=GRID, domain=DOMAIN))
    for k in range(1, 4):
        step = sequence.step(moved(0.2 + 0.05 * k))
    errors = step.solution.interpolation
    assert errors.l2_uniform / errors.l2 > 3.0


def test_few_lines_around_a_ring_do_not_end_a_descent() -> None:
    """The straight start crowds its lines at the peak: those of a coarse grid lie half a turn apart elsewhere."""
    peak = "exp(-19.297*((x-1.2934)**2+(y-0.4535)**2))"
    solution = least(em.AnnulusSector(closed=True), peak)
    errors = solution.interpolation
    assert errors.l2_uniform / errors.l2 > 2.0
    assert solution.cut_off.share <= solution.cut_off.most * (1.0 + 1e-6)
    assert any("since long cells cut the sides off" in text for text in solution.certificate.warnings)


def test_a_valid_mesh_with_a_folded_reference_is_followed() -> None:
    """The map of a ring bends: long cells can be valid there, and folded in the reference square."""
    functions = ["sin(4.8193*(0.9499*x+0.3125*y))*cos(3*(x+{})*y)", "tanh(20.223*((0.8093*x-0.5874*y)-1.44+{}))"]
    ring, folded = em.AnnulusSector(closed=True), 0
    for u in functions:
        problem = em.Problem(monitor=em.LeastError(u=em.Expression(u.format(0.017))), grid=GRID, domain=ring)
        first = em.solve(problem)
        folded += first.reference.is_folded
        step = em.Sequence(problem, solution=first).step(em.Expression(u.format(-0.003)))
        assert not step.mesh.is_folded
        errors = step.solution.interpolation
        assert errors.l2 < errors.l2_uniform
    assert folded
