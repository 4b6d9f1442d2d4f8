"""A solve in parts: equal to the whole to the last bit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from cases import problem
from cluster_package.parts.whole import COARSE_POINTS, in_parts, low_strips, require_equal
from equimesh.fields import chunked_samples
from equimesh.meshes.rows import strips_of
from equimesh_cluster.messages import ALONE
from equimesh_cluster.parts.rows import cuts_of, nodes_across
from equimesh_cluster.parts.solve import OtherGridsNeededError, coarse_solution, solve_part

__all__ = ["low_strips"]

U = em.Expression("tanh(8*(x + y/2 - 0.75))")
ANNULUS = em.AnnulusSector(angles=(0, 120))


def on(domain: em.Domain, boundary: em.Boundary, monitor: em.Monitor, n_xi: int = 257, n_eta: int = 257) -> em.Problem:
    return em.Problem(monitor=monitor, grid=em.Grid(n_xi=n_xi, n_eta=n_eta), boundary=boundary, domain=domain)


@pytest.mark.usefixtures("low_strips")
@pytest.mark.parametrize(
    ("domain", "boundary"),
    [(em.Rectangle(), em.Boundary.TRACE), (ANNULUS, em.Boundary.ORTHOGONAL)],
    ids=["square", "annulus"],
)
def test_parts_are_equal_to_the_whole(domain: em.Domain, boundary: em.Boundary) -> None:
    case = on(domain, boundary, em.ArcLength(u=U, b=0.5))
    for mode in em.Mode:
        whole = em.solve(case, mode=mode, threads=1)
        assert whole.status is em.Status.CONVERGED
        for count in (1, 2, 3, 8):
            require_equal(in_parts(case, count, mode), whole)


GENTLE = em.Expression("tanh(2*(x + y/2 - 0.75)) + x*y")
MONITORS = {
    "curvature": em.Curvature(u=GENTLE),
    "smoothed": em.Smoothed(monitor=em.Curvature(u=GENTLE), radius=0.1),
    "weight": em.Weight(rho=em.Expression("1 + 5*exp(-20*((x - 0.4)**2 + (y - 0.6)**2))")),
    "intersection": em.Intersection(monitors=(em.Curvature(u=GENTLE), em.Weight(rho=em.Expression("1 + x")))),
}


@pytest.mark.usefixtures("low_strips")
@pytest.mark.parametrize("name", MONITORS)
def test_every_monitor_of_a_metric_is_solved_in_parts(name: str) -> None:
    for boundary, n_xi in ((em.Boundary.TRACE, 129), (em.Boundary.EQUIDISTRIBUTED_1D, 150)):
        case = on(em.Rectangle(x=(0, 2)), boundary, MONITORS[name], n_xi, 140)
        whole = em.solve(case, threads=1)
        assert whole.status is em.Status.CONVERGED
        for count in (2, 3):
            require_equal(in_parts(case, count), whole)


CURVED = em.Quadrilateral(
    left=em.Curve.of_expressions("-0.1*sin(pi*t)", "t"),
    right=em.Curve.of_expressions("1 + 0.1*sin(pi*t)", "t"),
    bottom=em.Curve.of_expressions("t", "0.2*sin(pi*t)"),
    top=em.Curve.of_expressions("t", "1 + 0.1*sin(2*pi*t)"),
)
AXES = np.linspace(-0.2, 1.2, 60), np.linspace(-0.2, 1.3, 50)
SAMPLES = np.tanh(3 * (AXES[0][:, None] + AXES[1] / 2 - 0.75))


def fields(folder: Path) -> Iterator[em.Field]:
    """The same u by formula, by samples in memory, and by samples in a file, several tiles of them."""
    x, y = AXES
    yield em.Expression("tanh(3*(x + y/2 - 0.75))")
    yield em.GridSamples(x=x, y=y, values=SAMPLES)
    np.savez(folder / "u.npz", x=x, y=y, values=SAMPLES)
    yield em.ChunkedSamples(path=folder / "u.npz")


@pytest.mark.usefixtures("low_strips")
def test_bits_do_not_depend_on_where_u_comes_from_or_how_rows_are_shared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunked_samples, "TILE", 20)
    boundaries = [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D, em.Boundary.TRACE]
    for u, boundary in zip(fields(tmp_path), boundaries, strict=True):
        case = on(CURVED, boundary, em.ArcLength(u=u), 257, 129)
        whole = em.solve(case, threads=1)
        assert whole.status is em.Status.CONVERGED
        for count, threads in ((5, 1), (7, 1), (2, 2)):
            require_equal(in_parts(case, count, threads=threads), whole)


def shared_nodes(strips: int, count: int) -> list[tuple[int, int]]:
    """The owners of the two halves of every node of the tree whose halves begin in different parts."""
    cuts = cuts_of(strips, count)
    part_of = [part for part, (first, last) in enumerate(pairwise(cuts)) for _ in range(first, last)]
    owners = [(part_of[node.first], part_of[node.middle]) for node in nodes_across(strips, cuts)]
    return [(left, right) for left, right in owners if left != right]


@pytest.mark.usefixtures("low_strips")
@pytest.mark.parametrize("count", [2, 3, 4, 5, 8])
def test_a_sweep_sends_64_bytes_for_every_node_of_a_cut_and_few_messages(count: int) -> None:
    """For 3 and 5 parts more: the sums and starts of the nodes of the tree that they share."""
    case = on(em.Rectangle(), em.Boundary.TRACE, em.ArcLength(u=U))
    found = in_parts(case, count, em.Mode.TIGHT)
    seen = 0
    for records in zip(*(part.records for part in found), strict=True):
        n = records[0].grid.n_eta
        sent, messages = Counter[str](), 0
        for record in records:
            for tag, traffic in record.traffic.items():
                sent[tag] += traffic.bytes
            messages = max(messages, sum(traffic.messages for traffic in record.traffic.values()))
        if records[0].step < 2 or records[0].converged:
            continue  # the first record of a level has the rows for its guess, and the last one the error
        seen += 1
        shared = shared_nodes(len(strips_of(records[0].grid.shape)), count)
        of_a_part = max(sum(part in owners for owners in shared) for part in range(count))
        assert sent["sums"] + sent["starts"] + sent["halo"] == (48 * (count - 1) + 16 * len(shared)) * n
        if count.bit_count() == 1:
            assert (len(shared), of_a_part) == (count - 1, count.bit_length() - 1)
        assert sent["push"] == 8 * n
        assert sent["agree"] <= 64 * count * count.bit_length()
        assert set(sent) == {"sums", "starts", "halo", "push", "agree"}
        assert messages <= of_a_part + count.bit_length() + 5
    assert seen >= 2


def test_a_sweep_of_up_to_128_parts_sends_at_most_96_bytes_for_every_node_of_a_cut() -> None:
    for count in (2, 3, 5, 7, 9, 17, 33, 65, 128):  # most of them next to a power of two, where it is most
        for strips in (count, 2 * count - 1, 300):
            assert 48 * (count - 1) + 16 * len(shared_nodes(strips, count)) <= 96 * (count - 1)
    assert len(shared_nodes(4096, 3)) == 5
    assert len(shared_nodes(4096, 5)) == 10


@pytest.mark.usefixtures("low_strips")
def test_a_relaxed_coarse_solution_is_interpolated_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    points = 33 * 33
    monkeypatch.setattr("equimesh.single_domain.level.MAX_RELAXED_POINTS", points)
    monitor = em.ArcLength(u=em.Expression("tanh(200*((x-0.5)**2 + (y-0.5)**2 - 0.09))"), a=1.0, b=0.0)
    case = on(em.Rectangle(), em.Boundary.TRACE, monitor, 129, 129)
    whole = em.solve(case, threads=1)
    assert whole.status is em.Status.RELAXED
    assert "points" in {one.what for one in whole.relaxed}
    require_equal(in_parts(case, 3, points=points), whole)
    with pytest.raises(em.SolveError, match="No valid mesh was found"):
        coarse_solution(case, allow_relaxed=False, threads=1, max_points=points)


@pytest.mark.usefixtures("low_strips")
def test_a_level_on_which_sweeps_fail_keeps_the_interpolated_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.single_domain.level.MAX_RELAXED_POINTS", COARSE_POINTS)
    case = on(em.Rectangle(), em.Boundary.TRACE, em.ArcLength(u=U))
    coarse = coarse_solution(case, threads=1, max_points=COARSE_POINTS)
    monkeypatch.setattr("equimesh.single_domain.level.MAX_SWEEPS", 0)
    found = solve_part(case, coarse, ALONE)
    assert found.status is em.Status.RELAXED
    assert [(one.what, one.reached) for one in found.relaxed] == [("points", 65)]
    assert not em.Mesh(found.mesh.x, found.mesh.y).is_folded


# The coarse solution.


def test_the_coarse_grid_is_the_finest_one_below_the_limit() -> None:
    case = problem("ring", 129)
    assert coarse_solution(case, max_points=70 * 70).grid.shape == (65, 65)
    assert coarse_solution(case, max_points=64 * 64).grid.shape == (33, 33)
    assert coarse_solution(case).grid.shape == (129, 129), "relaxed equations may be solved on this grid"


def test_what_has_no_metric_is_refused_with_what_to_take() -> None:
    u, grid = em.Expression("x*y"), em.Grid(n_xi=33, n_eta=33)
    for monitor in (em.Auto(u=u), em.LeastError(u=u)):
        with pytest.raises(em.InputError, match=r"has no metric, and is not solved in parts: take Curvature"):
            coarse_solution(em.Problem(monitor=monitor, grid=grid))
    periodic = em.ArcLength(u=em.Expression("sin(2*pi*x)"))
    closed = em.Problem(monitor=periodic, grid=grid, domain=em.Rectangle(periodic="x"))
    with pytest.raises(em.InputError, match="the lines of this domain are closed, and parts end at sides"):
        coarse_solution(closed)
    with pytest.raises(em.InputError, match="a gradient map is not solved in parts"):
        coarse_solution(em.Problem(monitor=em.Weight(rho=em.Expression("1 + x"), map="gradient"), grid=grid))
    with pytest.raises(em.InputError, match="a bound of the angles is not kept in parts"):
        coarse_solution(em.Problem(monitor=em.ArcLength(u=u, orthogonality=50.0), grid=grid))


def test_other_grids_are_asked_for_where_sweeps_fail_on_a_grid_of_another_shape(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = problem("ring", 257, 65, b=0.5)
    coarse = coarse_solution(case, threads=1, max_points=140 * 40)
    assert coarse.only_requested
    assert coarse.grid.shape == (129, 33)
    square = coarse_solution(case, threads=1, max_points=140 * 70, square=True)
    assert square.grid.shape == (129, 65)
    assert not square.only_requested
    monkeypatch.setattr("equimesh.single_domain.level.MAX_SWEEPS", 0)
    with pytest.raises(OtherGridsNeededError):
        solve_part(case, coarse, ALONE)


# Parts that are threads.


def test_more_parts_than_the_grids_have_strips_are_refused() -> None:
    case = problem("ring", 129)
    with pytest.raises(em.InputError, match="can be cut into at most 1 parts"):
        in_parts(case, 2)
