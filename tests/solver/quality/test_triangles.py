"""Errors of linear interpolation on triangles: against plain sums over the triangles of the mesh file."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.quality import triangles
from equimesh.quality.cells import BilinearCells
from equimesh.quality.interpolation import interpolation_errors
from equimesh.quality.resolution import Pieces
from equimesh.quality.triangles import halves, triangle_errors
from equimesh.solving.solution import Solution
from equimesh_coupling.parts import corner_cuts

SECTOR = em.AnnulusSector(center=(0.3, -0.4), radii=(0.6, 1.4), angles=(10.0, 100.0))
WAVE = em.Expression("tanh(8*(x - 0.4*y)) + x*y")


def bent(n_xi: int, n_eta: int, seed: int = 1, share: float = 0.3) -> em.Mesh:
    """A valid mesh of the unit square with uneven cells, of which some are cut along each diagonal."""
    uniform = em.Mesh.uniform(em.Grid(n_xi=n_xi, n_eta=n_eta))
    moves = np.random.default_rng(seed).uniform(-share, share, (2, n_xi, n_eta)) / max(n_xi, n_eta)
    return em.Mesh.of_unit_square(uniform.x + moves[0], uniform.y + moves[1])


def plain(mesh: em.Mesh, u: em.Field, parts: int = 4) -> tuple[float, float]:
    """The two norms, by the middles of ``parts**2`` equal parts of every triangle."""
    cells = np.zeros((mesh.grid.n_xi - 1, mesh.grid.n_eta - 1))
    rows = MeshData(mesh=mesh, u=None, q_eq=cells, subdomain=cells.astype(np.int64)).triangles()
    corners, nodal = mesh.points[rows], u.evaluate(*mesh.points.T)[0][rows]
    edges = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.det(edges)
    slope = np.linalg.solve(edges, (nodal[:, 1:] - nodal[:, :1])[..., None])[..., 0]
    upward = [(i + 1 / 3, j + 1 / 3) for i in range(parts) for j in range(parts - i)]
    downward = [(i + 2 / 3, j + 2 / 3) for i in range(parts) for j in range(parts - i - 1)]
    sums = np.zeros(2)
    for s, t in np.array(upward + downward) / parts:
        at = corners[:, 0] + s * edges[:, 0] + t * edges[:, 1]
        there, u_x, u_y = u.evaluate(*at.T, order=1)
        error = nodal @ [1 - s - t, s, t] - there
        sums += np.array([area @ error**2, area @ ((slope[:, 0] - u_x) ** 2 + (slope[:, 1] - u_y) ** 2)]) / parts**2
    return math.sqrt(sums[0]), math.sqrt(sums[1])


@pytest.mark.parametrize("domain", [em.Rectangle(), SECTOR], ids=["square", "sector"])
def test_the_errors_are_those_of_plain_sums(domain: em.Domain) -> None:
    mesh, uniform = map_mesh(bent(8, 7), domain), map_mesh(em.Mesh.uniform(em.Grid(n_xi=8, n_eta=7)), domain)
    errors = triangle_errors(mesh, WAVE, uniform)
    assert (errors.l2, errors.h1) == pytest.approx(plain(mesh, WAVE, 16), rel=1e-2)
    assert (errors.l2_uniform, errors.h1_uniform) == pytest.approx(plain(uniform, WAVE, 16), rel=1e-2)
    assert errors.resolved == (True, True)


def test_a_quadratic_is_measured_exactly() -> None:
    # On right triangles of width h the error of x^2 is x (h - x) along x alone: h^4 / 30 a unit of area.
    uniform = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=5))
    errors = triangle_errors(uniform, em.Expression("x**2"))
    assert errors.l2 == pytest.approx((1 / 8) ** 2 / math.sqrt(30), rel=1e-12)
    assert errors.h1 == pytest.approx((1 / 8) / math.sqrt(3), rel=1e-12)
    assert (errors.gain_l2, errors.gain_h1) == (1.0, 1.0)
    assert errors.variation == 1.0
    assert errors.largest is not None
    assert errors.largest.value == pytest.approx((1 / 16) ** 2, rel=0.05)


def test_a_linear_u_has_no_error_and_a_bilinear_one_has() -> None:
    mesh = bent(9, 9)
    assert triangle_errors(mesh, em.Expression("2*x - 3*y")).gain_l2 == 1.0
    assert triangle_errors(mesh, em.Expression("2*x - 3*y")).l2 < 1e-14
    bilinear = em.Expression("x*y")
    assert triangle_errors(em.Mesh.uniform(mesh.grid), bilinear).l2 > 1e-3
    assert interpolation_errors(em.Mesh.uniform(mesh.grid), bilinear).l2 < 1e-14


def test_a_layer_inside_triangles_is_refined_or_not_resolved() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    steep = triangle_errors(uniform, em.Expression("tanh(200*(x + y - 0.83))"))
    assert steep.resolved[0]
    assert (steep.l2, steep.h1) == pytest.approx(
        plain(uniform, em.Expression("tanh(200*(x + y - 0.83))"), 24), rel=0.03
    )
    assert not triangle_errors(uniform, em.Expression("where(x + y < 0.83, 0, 1)")).resolved[1]


def test_halves_are_the_triangles_of_the_mesh_file() -> None:
    mesh = bent(9, 6, seed=3, share=0.45)
    cells = BilinearCells(mesh)
    corner = np.arange(4.0 * cells.count).reshape(4, -1)
    pieces = halves(Pieces.of(cells, np.arange(cells.count), corner), corner_cuts(cells.shape))
    none = np.zeros(cells.shape)
    rows = MeshData(mesh=mesh, u=None, q_eq=none, subdomain=none.astype(np.int64)).triangles()
    assert np.array_equal(pieces.corners[:3].T, mesh.points[rows][:, :, 0])
    assert np.array_equal(pieces.corners[4:7].T, mesh.points[rows][:, :, 1])
    assert np.array_equal(pieces.corners[[3, 7]], pieces.corners[[2, 6]])
    assert np.array_equal(pieces.values[3], pieces.values[2])
    assert np.array_equal(np.sort(pieces.values[:3] % cells.count, axis=0)[0], np.repeat(np.arange(cells.count), 2))


def test_a_sample_stands_for_all_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = bent(90, 80)
    whole = triangle_errors(mesh, WAVE)
    monkeypatch.setattr(triangles, "sample", lambda rows: np.arange(0, rows.own.stop, 7))
    part = triangle_errors(mesh, WAVE)
    assert part.l2 != whole.l2
    assert (part.l2, part.h1) == pytest.approx((whole.l2, whole.h1), rel=0.02)


def test_a_folded_mesh_has_infinite_errors() -> None:
    mesh = bent(6, 6)
    mesh.x[2, 2] = 0.9
    errors = triangle_errors(mesh, WAVE)
    assert errors.l2 == errors.h1 == math.inf
    assert errors.gain_l2 == 0.0


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_a_solution_on_triangles_is_measured_on_triangles(norm: str) -> None:
    grid = em.Grid(n_xi=25, n_eta=21)
    u = em.Expression("exp(-50*((x - 0.5)**2 + (y - 0.5)**2))")  # its descents end alike on every processor

    def solved(kind: str) -> Solution:
        monitor = em.LeastError(u=u, norm=norm, cells=kind)  # type: ignore[arg-type]
        return em.solve(em.Problem(monitor=monitor, grid=grid), threads=1)

    on_triangles, on_cells = solved("triangle"), solved("quad")
    errors, others = on_triangles.interpolation, triangle_errors(on_cells.mesh, u)
    assert errors is not None
    assert errors == triangle_errors(on_triangles.mesh, u)
    assert min(errors.gain_l2, errors.gain_h1) >= 1.0
    assert on_triangles.descent[-1]["gain"] == pytest.approx(errors.estimated_gain(norm), rel=0.25)
    assert getattr(errors, norm) < 0.9 * getattr(others, norm)
