"""What a part has of a solution."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cluster_package.parts.whole import in_parts, low_strips
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh, MeshRows
from equimesh.meshes.rows import Rows
from equimesh.quality.interpolation import MIN_SAMPLED_CELLS, SAMPLING
from equimesh.quality.measures import MAX_GAUSS_CELLS
from equimesh.single_domain.level import Mode
from equimesh.solving.solution import Solution
from equimesh.solving.status import Status
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.messages import Channel, Counted, ThreadChannels
from equimesh_cluster.parts.part_solution import PartMeasures, PartSolution, equidistribution_of_part, measure_part
from equimesh_schema import Relaxed

__all__ = ["low_strips"]

# Quality and certificate of a mesh in parts: those of the whole mesh, to the last bit.

TANH = em.Expression("tanh(20*(x + y/2 - 0.75))")
PEAK = em.Expression("exp(-5e5*((x - 0.4033)**2 + (y - 0.7077)**2))")
JUMP = em.Expression("where(x + y < 0.9, 0, 1)")
SECTOR = em.AnnulusSector()


def bent(shape: tuple[int, int]) -> Mesh:
    """A smooth mesh of the reference square that solves nothing."""
    start = Mesh.uniform(em.Grid(n_xi=shape[0], n_eta=shape[1]))
    x, y = start.x, start.y
    return Mesh(x + 0.1 * x * (1 - x) * (1 + y), y - 0.1 * np.sin(np.pi * y) * np.sin(3 * x))


def solved(monitor: em.Monitor, reference: Mesh, domain: em.Domain = UNIT_SQUARE, **more: object) -> Solution:
    """A solution with this mesh, as if a solve had ended with it."""
    given = {
        "problem": em.Problem(monitor=monitor, grid=reference.grid, domain=domain),
        "schwarz": None,
        "mesh": map_mesh(reference, domain),
        "reference": reference,
        "status": Status.CONVERGED,
        "newton_steps": 7,
        "residual": 1e-9,
        "mode": Mode.DISCRETIZATION,
        "algebraic_error": 1e-10,
        "discretization_error": 1e-4,
    }
    return Solution(**{**given, **more})  # type: ignore[arg-type]


def held(mesh: Mesh, begin: int, end: int) -> MeshRows:
    """These rows of a mesh."""
    return MeshRows.of(mesh).within(begin, end)


def between_strips(shape: tuple[int, int], count: int) -> list[int]:
    """The first rows of all parts but the first one."""
    firsts = [first for first, _ in Rows.whole(shape).strips]
    return [firsts[k * len(firsts) // count] for k in range(1, count)]


def parts_of(solution: Solution, count: int, cuts: list[int] | None = None) -> list[PartSolution]:
    """The same solution in parts."""
    cuts = between_strips(solution.mesh.grid.shape, count) if cuts is None else cuts
    return [
        PartSolution(
            problem=solution.problem,
            mode=Mode.DISCRETIZATION,
            status=solution.status,
            mesh=part,
            reference=held(solution.reference, max(part.first - 1, 0), part.first + len(part.x)),
            newton_steps=solution.newton_steps,
            residual=solution.residual,
            relaxed=solution.relaxed,
            algebraic_error=solution.algebraic_error,
            discretization_error=solution.discretization_error,
        )
        for part in cut(solution.mesh, cuts)
    ]


def measured(parts: list[PartSolution]) -> list[PartMeasures]:
    def work(channel: Channel) -> PartMeasures:
        return measure_part(parts[channel.number], channel)

    return ThreadChannels(len(parts)).run(work)


def assert_equal(solution: Solution, count: int) -> None:
    found = measured(parts_of(solution, count))
    # The gain of a solver comes from a solve with the whole mesh, which no part has.
    certificate = replace(solution.certificate, solver_gain=None)
    for one in found:
        assert one.quality.summary() == solution.quality.summary()
        assert str(one.quality.interpolation_error) == str(solution.quality.interpolation_error)
        assert str(one.certificate) == str(certificate)
        assert repr(one.certificate) == repr(certificate)
    q_eq = np.concatenate([one.q_eq for one in found])
    assert np.array_equal(q_eq, solution.quality.q_eq.cells)


@pytest.mark.usefixtures("low_strips")
def test_q_eq_alone_is_that_of_the_whole_mesh() -> None:
    solution = solved(em.ArcLength(u=TANH), bent((150, 40)), SECTOR)
    parts = parts_of(solution, 3)
    found = ThreadChannels(3).run(lambda channel: equidistribution_of_part(parts[channel.number], channel))
    assert np.array_equal(np.concatenate(found), solution.quality.q_eq.cells)


@pytest.mark.parametrize(
    ("monitor", "shape", "domain", "counts"),
    [
        (em.ArcLength(u=TANH), (402, 399), UNIT_SQUARE, (1, 2, 3, 5)),  # a sample of the cells
        (em.Curvature(u=TANH, norm="h1"), (130, 2060), SECTOR, (8,)),
        (em.Weight(rho=em.Expression("1 + x*y")), (900, 90), SECTOR, (3,)),  # no u
        (em.LeastError(u=TANH, cells="triangle"), (700, 100), UNIT_SQUARE, (3,)),
        (em.LeastError(u=TANH, cells="triangle"), (402, 399), UNIT_SQUARE, (3,)),
    ],
)
def test_parts_have_the_quality_and_the_certificate_of_the_whole(
    monitor: em.Monitor, shape: tuple[int, int], domain: em.Domain, counts: tuple[int, ...]
) -> None:
    solution = solved(monitor, bent(shape), domain)
    for count in counts:
        assert_equal(solution, count)


@pytest.mark.usefixtures("low_strips")
@pytest.mark.parametrize("rows", [300, 200])
def test_parts_have_the_errors_of_all_cells(rows: int) -> None:
    """The metric is evaluated at the nodes of the larger mesh, and inside the cells of the smaller one."""
    solution = solved(em.Curvature(u=TANH), bent((rows, 70)), SECTOR)
    for count in (2, 3):
        assert_equal(solution, count)


@pytest.mark.parametrize("boundary", ["orthogonal", "equidistributed_1d"])
def test_the_residual_on_other_sides_is_that_of_the_whole(boundary: str) -> None:
    reference = bent((500, 150))
    problem = em.Problem(monitor=em.ArcLength(u=TANH), grid=reference.grid, boundary=em.Boundary(boundary))
    assert_equal(solved(problem.monitor, reference, problem=problem), 3)


def test_warnings_are_those_of_the_whole() -> None:
    uniform = Mesh.uniform(em.Grid(n_xi=700, n_eta=110))
    flat = solved(em.ArcLength(u=PEAK), uniform)
    assert any("uniform although u varies" in warning for warning in flat.certificate.warnings)
    assert_equal(flat, 3)
    relaxed = Relaxed(what="points", asked=700, reached=350)
    assert_equal(solved(em.ArcLength(u=PEAK), bent((700, 110)), status=Status.RELAXED, relaxed=(relaxed,)), 2)
    thin = bent((700, 110))
    thin.x[300] = thin.x[301] - 1e-10
    thin_solution = solved(em.ArcLength(u=TANH), thin)
    assert any("smallest Jacobian" in warning for warning in thin_solution.certificate.warnings)
    assert_equal(thin_solution, 3)


def test_a_folded_cell_in_one_part_is_known_to_all() -> None:
    mesh = bent((700, 110))
    mesh.x[5, 7] = mesh.x[9, 7]
    solution = solved(em.ArcLength(u=TANH), mesh, status=Status.FOLDED)
    assert math.isinf(solution.quality.q_geo.max)
    assert math.isnan(solution.faces.skewness)
    assert_equal(solution, 3)


@pytest.mark.parametrize("shape", [(700, 110), (402, 399)])
def test_a_jump_inside_cells_is_divided_alike(shape: tuple[int, int]) -> None:
    solution = solved(em.ArcLength(u=JUMP, scaled=False), bent(shape))
    whole = solution.interpolation
    assert whole.resolved == (True, False)
    for one in measured(parts_of(solution, 3)):
        errors = one.quality.interpolation_error
        for name in ("l2", "l2_uniform", "h1", "h1_uniform", "gain_l2"):
            assert getattr(errors, name) == pytest.approx(getattr(whole, name), rel=8e-13), name
        assert (errors.resolved, errors.largest, errors.variation) == (whole.resolved, whole.largest, whole.variation)
        assert one.certificate.warnings == solution.certificate.warnings


def test_parts_that_are_cut_anywhere_differ_by_rounding_alone() -> None:
    solution = solved(em.Curvature(u=TANH), bent((300, 90)), SECTOR)
    whole = solution.quality
    for one in measured(parts_of(solution, 4, [1, 2, 120])):
        for name in ("q_eq", "q_ali", "size_ratio", "skewness"):
            here, there = getattr(one.quality, name), getattr(whole, name)
            assert (here.min, here.mean, here.rms) == pytest.approx((there.min, there.mean, there.rms), rel=1e-13), name
        assert one.certificate.faces.skewness == solution.faces.skewness
        assert one.certificate.equation_residual == pytest.approx(solution.certificate.equation_residual, rel=1e-12)


def test_the_measures_are_small_and_can_be_sent() -> None:
    solution = solved(em.ArcLength(u=TANH), bent((402, 399)))
    one = measured(parts_of(solution, 2))[1]
    sent = pickle.dumps(one.without_cells())
    assert len(sent) < 5000
    assert repr(pickle.loads(sent).certificate) == repr(solution.certificate)
    with pytest.raises(InputError, match="where the parts of the mesh are"):
        _ = one.quality.q_geo.cells


def test_little_travels() -> None:
    shape = (402, 399)
    parts = parts_of(solved(em.ArcLength(u=TANH), bent(shape)), 4)

    def work(channel: Channel) -> tuple[int, int]:
        counted = Counted(channel)
        measure_part(parts[channel.number], counted)
        sent = counted.sent.values()
        return sum(one.messages for one in sent), sum(one.bytes for one in sent)

    for messages, size in ThreadChannels(4).run(work):
        assert messages < 100
        assert size < 8 * 25 * sum(shape)


def test_meshes_are_large_enough_for_a_sample_of_their_cells_or_small_enough_for_all() -> None:
    one_of = SAMPLING[-1][0]
    assert 401 * 398 > 299 * 69 > one_of * MIN_SAMPLED_CELLS >= MAX_GAUSS_CELLS > 199 * 69


@pytest.mark.usefixtures("low_strips")
def test_a_solve_in_parts_has_the_certificate_of_the_whole_solve() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=TANH), grid=em.Grid(n_xi=129, n_eta=65), domain=SECTOR)
    whole = em.solve(problem)
    for one in measured(in_parts(problem, 3)):
        for name, expected in whole.quality.summary().items():
            assert one.quality.summary()[name] == pytest.approx(expected, rel=1e-9), name
        found, expected = one.certificate.summary(), whole.certificate.summary()
        assert found["equation_residual"] == pytest.approx(expected["equation_residual"], rel=1e-3)
        for name in ("status", "mode", "warnings", "relaxed", "resolved"):
            assert found[name] == expected[name], name
        assert found["non_orthogonality"] == pytest.approx(expected["non_orthogonality"], rel=1e-9)
        assert found["algebraic_error"] == pytest.approx(expected["algebraic_error"], rel=1e-6)
