"""Checks of cells and faces, and the error of a cell-centred code, by hand and against those of OpenFOAM 1912."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import equimesh as em
from block_cases import channel, in_blocks
from cases import problem
from equimesh.domains.domain import closed_of, map_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.quality.faces import check_cells, measure_faces, poisson_error


def waves(shape: tuple[int, int], domain: em.Domain) -> Mesh:
    """A smooth mesh that is oblique everywhere, without a solve."""
    s, t = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in shape), indexing="ij")
    x = s + 0.06 * np.sin(2 * np.pi * s) * np.sin(3 * np.pi * t)
    y = t + 0.05 * np.sin(3 * np.pi * s) * np.sin(2 * np.pi * t)
    return map_mesh(Mesh(x, y), domain)


@pytest.mark.parametrize(
    ("mesh", "largest", "mean", "skewness"),
    [
        (waves((17, 13), em.Rectangle()), 48.08795399651592, 21.67502629886008, 0.6521059590804418),
        (waves((9, 25), em.AnnulusSector()), 58.42239755020146, 26.84092768886008, 1.300867657977332),
    ],
)
def test_the_values_of_check_mesh(mesh: Mesh, largest: float, mean: float, skewness: float) -> None:
    """``checkMesh -allTopology -allGeometry`` of OpenFOAM 1912 printed these for the same nodes, one cell thick."""
    faces = measure_faces(mesh)
    assert faces.non_orthogonality == pytest.approx(largest, rel=1e-12)
    assert faces.mean_non_orthogonality == pytest.approx(mean, rel=1e-12)
    assert faces.skewness == pytest.approx(skewness, rel=1e-12)


def test_cells_of_parallelograms() -> None:
    """All faces of one family have the angle of the shear, the other none that differs; only sides are skew."""
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 5), indexing="ij")
    faces = measure_faces(Mesh(s + t, t))
    assert faces.non_orthogonality == pytest.approx(45.0)
    assert faces.mean_non_orthogonality == pytest.approx(45.0)
    # The centre is 1/8 off the foot on the sides bottom and top, where half an edge is 1/8.
    assert faces.skewness == pytest.approx(1.0)


def test_a_rectangle_has_right_angles_and_a_folded_mesh_none() -> None:
    uniform = Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    right = measure_faces(uniform)
    assert right.non_orthogonality == right.mean_non_orthogonality == 0.0
    assert right.skewness < 1e-15
    folded = Mesh(uniform.x.copy(), uniform.y.copy())
    folded.x[2, 1] = 0.9
    faces = measure_faces(folded)
    assert math.isnan(faces.skewness)
    assert json.dumps(faces.summary()) == '{"max": null, "mean": null}'


def test_the_certificate_has_them_and_warns_over_60_degrees() -> None:
    steep = em.LeastError(u=em.Expression("tanh(30*(y - 0.5 - 0.25*sin(2*pi*x)))"))
    certificate = em.solve(em.Problem(monitor=steep, grid=em.Grid(n_xi=17, n_eta=17))).certificate
    summary = certificate.summary()
    assert summary["non_orthogonality"]["max"] == certificate.faces.non_orthogonality > 60.0
    assert summary["skewness"] == certificate.faces.skewness
    (warning,) = (text for text in certificate.warnings if "Finite-volume" in text)
    assert f"{certificate.faces.non_orthogonality:.0f} degrees" in warning
    assert "non-orthogonality" in str(certificate)
    gentle = em.solve(problem("tanh20", 17)).certificate
    assert 0.0 < gentle.faces.non_orthogonality < 60.0
    assert not [text for text in gentle.warnings if "Finite-volume" in text]


def test_blocks_have_the_faces_of_their_grid() -> None:
    grid = waves((17, 13), em.Rectangle())
    found, expected = measure_faces(in_blocks(grid).mesh), measure_faces(grid)
    assert found.summary() == pytest.approx(expected.summary(), rel=1e-12)
    assert found.skewness == pytest.approx(expected.skewness, rel=1e-12)
    bent = in_blocks(Mesh(np.where(grid.x == grid.x[8, 6], 0.9, grid.x), grid.y)).mesh
    assert math.isnan(measure_faces(bent).non_orthogonality)


def test_a_seam_of_a_ring_is_no_side() -> None:
    """Any line across the ring could be the seam."""
    ring, (s, t) = (
        em.AnnulusSector(closed=True),
        np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 25), indexing="ij"),
    )
    bent = Mesh(
        s + 0.02 * np.sin(2 * np.pi * s) * np.sin(2 * np.pi * t), t + 0.01 * np.sin(3 * s) * np.sin(2 * np.pi * t)
    )
    grid = map_mesh(bent, ring)
    rolled = Mesh(*(np.concatenate([q[:, 5:-1], q[:, :6]], axis=1) for q in (grid.x, grid.y)))
    found, expected = (measure_faces(one, closed_of(ring)) for one in (rolled, grid))
    assert found.summary() == pytest.approx(expected.summary(), rel=1e-12)
    assert found.skewness == pytest.approx(expected.skewness, rel=1e-12)
    assert measure_faces(rolled).summary() != pytest.approx(expected.summary(), rel=1e-6)


def test_a_join_is_a_face_without_its_translation() -> None:
    """Any column of the channel could be the one that is joined."""
    mesh = channel()
    block = mesh.blocks[0]
    rolled = np.roll(mesh.points[block[:-1]], 4, axis=0)
    rolled[:4, :, 0] -= 2.0
    points = mesh.points.copy()
    points[block[:-1]], points[block[-1]] = rolled, rolled[0] + [2.0, 0.0]
    found, expected = measure_faces(mesh.moved(points)), measure_faces(mesh)
    assert found.summary() == pytest.approx(expected.summary(), rel=1e-12)
    assert found.skewness == pytest.approx(expected.skewness, rel=1e-12)


@pytest.mark.parametrize(
    ("mesh", "determinant", "weight", "volume_ratio"),
    [
        (waves((17, 13), em.Rectangle()), 0.1086889587357588, 0.444632629272834, 0.6838339028141148),
        (waves((9, 25), em.AnnulusSector()), 0.09539239440834739, 0.4047638058692445, 0.5387267305538241),
    ],
)
def test_the_numbers_of_check_mesh(mesh: Mesh, determinant: float, weight: float, volume_ratio: float) -> None:
    """Those of ``checkMesh -allTopology -allGeometry`` of OpenFOAM 1912 for the same nodes, one cell thick."""
    checks = check_cells(mesh)
    assert checks.determinant == pytest.approx(determinant, rel=1e-12)
    assert checks.weight == pytest.approx(weight, rel=1e-12)
    assert checks.volume_ratio == pytest.approx(volume_ratio, rel=1e-12)
    assert checks.passed


def test_thin_cells_sudden_changes_and_folds_do_not_pass() -> None:
    def product(x: np.ndarray, y: np.ndarray) -> Mesh:
        return Mesh(*np.meshgrid(x, y, indexing="ij"))

    even = np.linspace(0.0, 1.0, 9)
    assert check_cells(product(even, even)).passed
    thin = check_cells(product(even, even / 100))
    assert thin.determinant < 0.001
    assert not thin.passed
    sudden = check_cells(product(np.array([0.0, 0.01, 0.5, 1.0]), np.linspace(0.0, 1.0, 4)))
    assert sudden.weight == pytest.approx(0.01 / 0.5)
    assert sudden.volume_ratio == pytest.approx(0.01 / 0.49)
    assert not sudden.passed
    folded = product(even[[0, 2, 1, 3]], even)
    assert math.isnan(check_cells(folded).determinant)
    assert not check_cells(folded).passed


U = em.Expression("exp(x)*sin(3*y) + tanh(4*(x - y))")


@pytest.mark.parametrize(
    ("mesh", "error"),
    [(waves((17, 13), em.Rectangle()), 0.024984034231097636), (waves((9, 25), em.AnnulusSector()), 0.1878909067826689)],
)
def test_the_error_of_open_foam(mesh: Mesh, error: float) -> None:
    """``Gauss linear corrected`` with 120 corrections gave these, with u at the middles of the faces of the sides."""
    assert poisson_error(mesh, U) == pytest.approx(error, rel=1e-9)


def test_the_error_on_uniform_meshes_is_of_second_order() -> None:
    errors = [poisson_error(Mesh.uniform(em.Grid(n_xi=n, n_eta=n)), U) for n in (17, 33, 65)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.03)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.01)
    assert errors[2] < 5e-4


def test_what_is_linear_has_no_error_on_an_orthogonal_mesh() -> None:
    assert poisson_error(Mesh.uniform(em.Grid(n_xi=9, n_eta=7)), em.Expression("3*x - y + 2")) < 1e-13


def test_a_folded_mesh_and_a_source_that_is_not_finite_have_none() -> None:
    uniform = Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    assert poisson_error(uniform, em.Expression("log((x - 0.375)**2 + (y - 0.375)**2)")) == math.inf
    folded = Mesh(uniform.x.copy(), uniform.y)
    folded.x[1, 1] = 0.9
    assert poisson_error(folded, U) == math.inf
