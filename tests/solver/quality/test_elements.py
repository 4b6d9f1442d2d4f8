"""Elements: shape functions, quadrature, and triangles that are those of the mesh file."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.kernels import Nodes, Rule
from equimesh.quality.elements import CellKind, basis, lobatto, nodes_of, quadrilateral, rule, triangle
from solver.bent import bent, objective_on, uniform

ELEMENTS = {
    **{f"quad {n}": quadrilateral(n) for n in (2, 3, 4, 5)},
    "triangle": triangle(),
    "finer triangle": triangle(finer=True),
}
BASES: list[tuple[CellKind, int]] = [*(("quad", degree) for degree in (1, 2, 3, 4)), ("triangle", 1), ("triangle", 2)]
CORNERS = {4: np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), 3: np.array([[0, 0], [1, 0], [0, 1.0]])}


@pytest.mark.parametrize("name", ELEMENTS)
def test_weights_sum_to_the_area_and_shape_functions_to_one(name: str) -> None:
    element = ELEMENTS[name]
    assert element.weights.sum() == pytest.approx(1.0 if element.shape.shape[1] == 4 else 0.5, rel=1e-14)
    assert np.abs(element.shape.sum(axis=1) - 1.0).max() < 1e-14
    assert np.abs(element.along_s.sum(axis=1)).max() < 1e-14
    assert np.abs(element.along_t.sum(axis=1)).max() < 1e-14
    assert (element.shape > 0.0).all()
    assert (element.weights > 0.0).all()


@pytest.mark.parametrize("name", ELEMENTS)
def test_shape_functions_and_their_derivatives_belong_to_the_points(name: str) -> None:
    element = ELEMENTS[name]
    s, t = (element.shape @ CORNERS[element.shape.shape[1]]).T
    if element.shape.shape[1] == 3:
        expected = [1 - s - t, s, t], [-1, 1, 0], [-1, 0, 1]
    else:
        expected = ([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], [t - 1, 1 - t, t, -t], [s - 1, -s, s, 1 - s])
    for got, parts in zip((element.shape, element.along_s, element.along_t), expected, strict=True):
        for corner, part in enumerate(parts):
            assert got[:, corner] == pytest.approx(part, abs=1e-14)


@pytest.mark.parametrize(("finer", "degree"), [(False, 4), (True, 6)])
def test_the_rules_of_triangles_are_exact_to_their_degree(finer: bool, degree: int) -> None:
    element = triangle(finer=finer)
    s, t = (element.shape @ CORNERS[3]).T
    factorial = [1, 1, 2, 6, 24, 120, 720, 5040, 40320]
    for p in range(degree + 1):
        for q in range(degree + 1 - p):
            exact = factorial[p] * factorial[q] / factorial[p + q + 2]
            assert element.weights @ (s**p * t**q) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize(("cells", "degree"), BASES)
def test_a_basis_interpolates_the_polynomials_of_its_degree(cells: CellKind, degree: int) -> None:
    (a, b), element = nodes_of(cells, degree), rule(cells, 5)
    found = basis(cells, degree, element)
    s, t = (element.shape @ CORNERS[element.shape.shape[1]]).T
    assert np.array_equal(found.places[: len(element.shape.T)], np.eye(len(element.shape.T)))
    assert found.places @ CORNERS[element.shape.shape[1]] == pytest.approx(np.stack([a, b], axis=1), abs=1e-15)
    for p in range(degree + 1):
        for q in range(degree + 1 if cells == "quad" else degree + 1 - p):
            nodal = a**p * b**q
            assert nodal @ found.value == pytest.approx(s**p * t**q, abs=1e-13)
            assert nodal @ found.along_s == pytest.approx(p * s ** max(p - 1, 0) * t**q, abs=1e-12)
            assert nodal @ found.along_t == pytest.approx(q * t ** max(q - 1, 0) * s**p, abs=1e-12)


def test_nodes_are_gauss_lobatto_points() -> None:
    assert lobatto(3) == pytest.approx([0.0, 0.5 - 0.05**0.5, 0.5 + 0.05**0.5, 1.0], abs=1e-15)
    assert lobatto(4) == pytest.approx([0.0, 0.5 - (3 / 28) ** 0.5, 0.5, 0.5 + (3 / 28) ** 0.5, 1.0], abs=1e-15)


def test_the_squared_error_of_a_quadratic_on_triangles_is_exact() -> None:
    # Of x^2 the linear interpolant on right triangles of width h has the squared error h^4 / 30 a unit of area:
    # x (h - x) along x alone.
    grid, h = em.Grid(n_xi=9, n_eta=5), 1 / 8
    error = objective_on(grid, em.Expression("x**2"), rule=Rule(cells="triangle")).error(uniform(grid))
    assert error == pytest.approx(h**2 / 30**0.5, rel=1e-12)
    # The gradient's error is 2 x - h on every triangle: its square has the mean h^2 / 3.
    slope = objective_on(grid, em.Expression("x**2"), rule=Rule(cells="triangle", norm="h1")).error(uniform(grid))
    assert slope == pytest.approx(h / 3**0.5, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_triangles_are_those_of_the_mesh_file(seed: int) -> None:
    grid = em.Grid(n_xi=9, n_eta=6)
    s, t = bent(grid, seed, share=0.45)
    mesh = em.Mesh(s.reshape(grid.shape), t.reshape(grid.shape))
    nodes = Nodes(s, t, mesh.cells.reshape(-1))
    elements = Rule(cells="triangle").elements(len(mesh.cells), nodes, cells_of_grid(grid.shape).corner_cuts)
    cells = np.zeros((grid.n_xi - 1, grid.n_eta - 1))
    data = em.MeshData(mesh=mesh, u=None, q_eq=cells, subdomain=cells.astype(np.int64))
    assert np.array_equal(nodes.corners[elements], data.triangles())
    assert len({tuple(row) for row in elements[::2] % 4}) == 2  # both cuts occur
