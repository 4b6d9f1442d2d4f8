"""Schwarz that scales: how many iterations it takes, and that the mesh is the same for any decomposition."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache

import functions
import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.nested import halved, prolong
from equimesh.schwarz.line_corrections import LineCorrections

FUNCTIONS = ("paper", "sine", "ring", "tanh20", "tanh60", "wave")
COUNTS = (2, 4, 8, 16, 32)
FEWER = (2, 4, 32)  # with 4 some functions take most
STRIPS_XI = [(count, 1) for count in COUNTS]
STRIPS_ETA = [(1, count) for count in COUNTS]
BLOCKS = [(2, 2), (4, 4), (8, 8)]
FAMILIES = [STRIPS_XI, STRIPS_ETA, BLOCKS, [(3, 5)]]
OVERLAPS = (2, 4)

CLASSICAL = em.Schwarz(transmission=em.Classical(), line_correction=3, acceleration=em.Acceleration.ANDERSON)


@dataclass(frozen=True)
class Case:
    """A problem with its single-domain mesh, and the mesh of a grid half as fine to start from."""

    problem: em.Problem
    mesh: em.Mesh
    start: em.Mesh

    @classmethod
    @cache
    def of(cls, name: str, n: int) -> Case:
        problem = _problem(name, em.Grid(n_xi=n, n_eta=n))
        coarser = em.solve(_problem(name, halved(problem.grid)), mode=em.Mode.TIGHT).reference
        mesh = em.solve(problem, mode=em.Mode.TIGHT).reference
        return cls(problem, LineCorrections(problem, 1).apply(mesh, 4).mesh, prolong(coarser, problem.grid))

    def error(self, mesh: em.Mesh) -> float:
        return max(float(np.abs(mesh.x - self.mesh.x).max()), float(np.abs(mesh.y - self.mesh.y).max()))

    def iterations(self, settings: em.Schwarz, *, claimed: bool = True) -> int:
        """Until the error has fallen by 1e-6, to 1e-9 at least, and with ``claimed`` where that is claimed, too."""
        needed, bound = None, min(1e-6 * self.error(self.start), 1e-9)
        for record in itertools.islice(em.iterate(self.problem, settings, self.start), 15):
            error = self.error(record.reference)
            if needed is None and error <= bound:
                needed = record.iteration
            if record.meets(1e-10):
                assert error < 1e-9, settings
                claimed = False
            if needed is not None and not claimed:
                return needed
        raise AssertionError(f"not converged: {settings}")


def _problem(name: str, grid: em.Grid) -> em.Problem:
    return em.Problem(monitor=em.ArcLength(u=em.Expression(functions.FUNCTIONS[name].u)), grid=grid)


def _families(name: str, everything: bool, counts: tuple[int, ...] = COUNTS) -> list[tuple[int, list[tuple[int, int]]]]:
    """Families of decompositions, each with its overlap.

    With ``everything`` each family with each overlap. Otherwise two of the four families for each function, with
    overlaps that change from family to family and from function to function, and of strips only those of so many
    ``counts``: every decomposition with both overlaps, and every function with both.
    """
    shift = FUNCTIONS.index(name)
    if everything:
        return list(itertools.product(OVERLAPS, FAMILIES))
    chosen = [k % len(FAMILIES) for k in (shift, shift + 1)]
    return [
        (OVERLAPS[(shift + k) % 2], [one for one in FAMILIES[k] if 1 not in one or max(one) in counts]) for k in chosen
    ]


@pytest.mark.parametrize(
    "n", [65, pytest.param(129, marks=pytest.mark.everything), pytest.param(257, marks=pytest.mark.everything)]
)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_default_kind_needs_8_iterations_at_most_and_gives_the_single_domain_mesh(
    name: str, n: int, everything: bool
) -> None:
    """In practice 7. From the smallest to the largest number of subdomains the count grows by 2 at most.

    Without ``--everything``: the pairs of :func:`_families` on the coarsest grid, with 2, 4 and 32 strips and all
    blocks. On the finer ones also then only with these.
    """
    case = Case.of(name, n)
    for overlap, family in _families(name, everything, COUNTS if everything and n == 65 else FEWER):
        counts = {
            subdomains: case.iterations(em.Schwarz(subdomains=subdomains, overlap=overlap), claimed=n == 65)
            for subdomains in family
        }
        assert max(counts.values()) <= 7, counts
        assert counts[family[-1]] - counts[family[0]] <= 2, counts


@pytest.mark.parametrize("name", FUNCTIONS)
def test_classical_with_line_corrections_needs_12_iterations_at_most(name: str, everything: bool) -> None:
    """In practice 9, where without them 4 strips take some 60 (tests/proofs/test_rates.py).

    Without ``--everything``: the pairs of :func:`_families`, with 4 strips and all blocks.
    """
    case = Case.of(name, 65)
    for overlap, family in _families(name, everything, FEWER if everything else (4,)):
        for subdomains in family:
            settings = replace(CLASSICAL, subdomains=subdomains, overlap=overlap)
            assert case.iterations(settings) <= 9, settings


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_mesh_depends_on_no_ordering(name: str, everything: bool) -> None:
    """Those besides the parallel one, which the other tests run; each with fewer iterations, or as many.

    Without ``--everything``: every other decomposition of each function, all with three of the six functions.
    """
    case = Case.of(name, 33)
    decompositions = [(2, 1), (1, 7), (12, 1), (2, 2), (3, 5)]
    for subdomains in decompositions if everything else decompositions[FUNCTIONS.index(name) % 2 :: 2]:
        settings = [em.Schwarz(subdomains=subdomains, overlap=3, ordering=ordering) for ordering in em.Ordering]
        counts = {str(one.ordering): case.iterations(one) for one in settings}
        assert max(counts.values()) <= 7, counts


STAR = "tanh(23.9*(sqrt((x-0.4781)**2 + (y-0.5411)**2 + 1e-4) - 0.217 - 0.033*cos(5*atan2(y-0.5411, x-0.4781))))"


@cache
def star() -> tuple[em.Problem, em.Solution]:
    """The problem of that function, and its single-domain solution."""
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression(STAR)), grid=em.Grid(n_xi=65, n_eta=65))
    return problem, em.solve(problem, mode=em.Mode.TIGHT)


@pytest.mark.parametrize(
    ("subdomains", "overlap"),
    [((2, 2), 5), *(pytest.param(*one, marks=pytest.mark.everything) for one in (((4, 4), 2), ((6, 1), 3)))],
)
def test_a_mesh_that_is_hard_to_find_needs_8_iterations_at_most(subdomains: tuple[int, int], overlap: int) -> None:
    """Sweeps hardly converge on it; Newton's method takes over the acceleration. No single-domain solve does."""
    problem, single = star()
    assert single.status is em.Status.CONVERGED
    settings = em.Schwarz(subdomains=subdomains, overlap=overlap, compare_single_domain=True, fallback=False)
    found = em.solve(problem, settings)
    assert found.status is em.Status.CONVERGED
    errors = [record.error for record in found.iterations if record.error is not None]
    assert next(k for k, error in enumerate(errors) if error <= 1e-6 * errors[0]) <= 8, errors
    assert found.reference.distance(single.reference) < 1e-9


def test_line_sums_make_the_count_independent_of_the_number_of_strips() -> None:
    """Without line corrections and acceleration, which would hide it."""
    case = Case.of("paper", 65)
    counts: dict[em.LineData, list[int]] = {data: [] for data in em.LineData}
    for data, count in itertools.product(em.LineData, (2, 4, 8)):
        settings = em.Schwarz(
            subdomains=(count, 1),
            transmission=em.Optimized(data=data),
            line_correction=0,
            acceleration=em.Acceleration.NONE,
        )
        bound = 1e-6 * case.error(case.start)
        records = em.iterate(case.problem, settings, case.start)
        counts[data].append(next(r.iteration for r in records if case.error(r.reference) <= bound))
    assert max(counts[em.LineData.LINE_SUMS]) <= 6
    assert counts[em.LineData.LOCAL] == sorted(counts[em.LineData.LOCAL])
    assert counts[em.LineData.LOCAL][-1] >= 3 * counts[em.LineData.LOCAL][0]


def test_meshes_do_not_depend_on_the_number_of_threads() -> None:
    case = Case.of("wave", 129)  # line corrections share out so many points
    for ordering in (em.Ordering.PARALLEL, em.Ordering.COLOURED):
        settings = em.Schwarz(subdomains=(3, 2), ordering=ordering)
        one, *others = (
            list(itertools.islice(em.iterate(case.problem, settings, case.start, threads=threads), 2))[-1].reference
            for threads in (1, 2, 5)
        )
        assert all(np.array_equal(one.x, other.x) and np.array_equal(one.y, other.y) for other in others)


def test_traffic_grows_like_the_side_of_the_grid_and_work_like_its_points() -> None:
    found = []
    for n in (65, 129):
        case = Case.of("tanh20", n)
        settings = em.Schwarz(subdomains=(4, 4), tolerance=None)
        last = list(itertools.islice(em.iterate(case.problem, settings, case.start), 2))[-1]
        found.append((last.traffic, last.work / case.problem.grid.points))
    (traffic, work), (finer_traffic, finer_work) = found
    assert finer_traffic / traffic == pytest.approx(2.0, abs=0.2)
    assert finer_work == pytest.approx(work, rel=0.2)
    assert work < 10


@pytest.mark.parametrize("condition", [em.LinearRobin(), em.NonlinearRobin()], ids=lambda c: c.name)
def test_line_corrections_help_every_condition(condition: em.TransmissionCondition) -> None:
    """With them a Robin condition converges on a steep front where it had stalled."""
    case = Case.of("ring", 33)
    settings = em.Schwarz(subdomains=(1, 4), overlap=3, transmission=condition, fallback=False)
    corrected = em.Schwarz(
        subdomains=(1, 4), overlap=3, transmission=condition, fallback=False, line_correction=3, acceleration="none"
    )
    bound = 1e-4 * case.error(case.start)
    errors = [
        [case.error(r.reference) for r in itertools.islice(em.iterate(case.problem, s, case.start), 8)]
        for s in (settings, corrected)
    ]
    assert min(errors[0]) > bound
    assert min(errors[1]) < bound
