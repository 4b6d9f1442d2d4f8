"""What a step says of integrals."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.sequences.sequence import about_integrals
from solver.meshes.quad_cases import disc, turned


def test_a_changed_integral_is_told_with_its_size() -> None:
    old, new = disc(4), turned(disc(4), 0.1)
    field = {"rho": em.MeshValues(np.ones(len(old.points)), transfer="conservative")}
    assert list(about_integrals((old, new), field, {"rho": np.ones(len(new.points))})) == []
    (said,) = about_integrals((old, new), field, {"rho": np.full(len(new.points), 1.1)})
    assert said.startswith("The integral of rho changed by 1.0e-01 of itself")


def test_each_component_counts_and_splines_are_not_told() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    values = np.ones((5, 4, 2))
    other = values * [1.0, 2.0]
    for transfer, count in (("spline", 0), ("conservative", 1)):
        field = {"u": em.MeshValues(values, transfer=transfer)}
        assert len(list(about_integrals((mesh, mesh), field, {"u": other}))) == count
