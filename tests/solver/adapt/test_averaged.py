"""The next mesh of blocks from averages over the cells: better, and of cells that suit finite volumes."""

from __future__ import annotations

import equimesh as em
from equimesh.adapt.loop import averaged_mesh
from equimesh.quality.faces import measure_faces
from equimesh.testing import GEOMETRIES


def test_cells_stay_even_where_the_usual_weights_make_them_oblique() -> None:
    domain = GEOMETRIES["step"](400)
    layer = em.Expression("tanh(8*(y - 0.5 - 0.1*x))")
    u = em.QuadField(mesh=domain.mesh, values=layer.evaluate(*domain.mesh.points.T)[0])
    even = averaged_mesh(u, domain, "l2", threads=1)
    usual = em.adapt_round(domain.mesh, u.values, domain)
    assert even.distance(domain.mesh) > 0.0
    assert measure_faces(even).non_orthogonality < 0.7 * measure_faces(usual.mesh).non_orthogonality


def test_the_mesh_of_a_linear_function_is_the_one_before() -> None:
    domain = GEOMETRIES["step"](100)
    flat = em.QuadField(mesh=domain.mesh, values=domain.mesh.points[:, 0].copy())
    assert averaged_mesh(flat, domain, "l2", threads=1).distance(domain.mesh) == 0.0
