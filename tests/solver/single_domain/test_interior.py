"""Newton's method without a matrix: the equations of the matrix, its products, and as few for every grid."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import newton_steps
from equimesh.numerics.newton import newton_iterations
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import Interior, scale
from equimesh.single_domain.solved_sides import with_solved_sides

WEIGHT = 0.1


def started(points: int, boundary: em.Boundary = em.Boundary.TRACE) -> tuple[em.Problem, em.Mesh]:
    """A problem, and its uniform mesh with solved sides."""
    case = problem("ring", points, boundary=boundary)
    start = with_solved_sides(case, em.Mesh.uniform(case.grid))
    assert start is not None
    return case, start


def solved(interior: Interior, start: em.Mesh) -> tuple[em.Mesh, int]:
    """The mesh of Newton's method, down to rounding, and the number of its steps."""
    enough = 1e-11 * interior.mean_flux
    *_, last = newton_iterations(
        interior.residual,
        lambda z: z,
        interior.vector(start),
        admissible=interior.is_valid,
        tolerance=enough,
        factorise=interior.solver,
    )
    assert last.residual <= enough
    return interior.mesh(last.z), last.step


@pytest.mark.parametrize("boundary", em.Boundary)
def test_the_mesh_is_that_of_the_method_with_a_matrix(boundary: em.Boundary) -> None:
    case, start = started(17, boundary)
    weight = WEIGHT * scale(case)
    found, _ = solved(Interior(case, start, weight), start)
    *_, other = newton_steps(case.equations(weight), start)
    assert other.converged
    assert found.distance(other.mesh) < 1e-9


def test_products_are_those_with_the_jacobian() -> None:
    case, start = started(9)
    weight = WEIGHT * scale(case)
    interior, equations = Interior(case, start, weight), case.equations(weight)
    z = interior.vector(start)
    jacobian = equations.jacobian(equations.vector(start)).toarray()
    inside = np.zeros((9, 9), dtype=bool)
    inside[1:-1, 1:-1] = True
    kept = np.concatenate([inside.ravel(), inside.ravel()])
    matrix = jacobian[np.ix_(kept, kept)]
    right = np.random.default_rng(6).standard_normal(z.size)
    v = interior.solver(z)(right)
    assert np.linalg.norm(matrix @ v - right) <= 0.31 * np.linalg.norm(right)


def test_the_number_of_steps_does_not_grow_with_the_grid() -> None:
    counts = []
    for points in (17, 33, 65):
        case, start = started(points)
        counts.append(solved(Interior(case, start, WEIGHT * scale(case)), start)[1])
    assert max(counts) <= 12
    assert counts[2] <= counts[0] + 3


def test_the_unit_is_that_of_the_equations() -> None:
    case, start = started(9)
    equations = case.equations()
    expected = equations.mean_flux(equations.vector(start))
    assert Interior(case, start, 0.0).mean_flux == pytest.approx(expected)


def test_folded_and_undefined_meshes_are_not_valid() -> None:
    case, start = started(9)
    interior = Interior(case, start, 0.0)
    z: Array = interior.vector(start)
    assert interior.is_valid(z)
    far = z.copy()
    far[0] += 0.9
    assert not interior.is_valid(far)
    assert not interior.is_valid(np.full(z.size, np.nan))


def test_orthogonal_sides_follow_the_interior() -> None:
    case, start = started(9, em.Boundary.ORTHOGONAL)
    interior = Interior(case, start, 0.0)
    z = interior.vector(start)
    z[:49] += 0.001
    mesh = interior.mesh(z)
    assert -3.0 * mesh.x[1:-1, 0] + 4.0 * mesh.x[1:-1, 1] - mesh.x[1:-1, 2] == pytest.approx(0.0, abs=1e-14)
    assert (mesh.x[0] == 0.0).all()
    assert (mesh.x[-1] == 1.0).all()
