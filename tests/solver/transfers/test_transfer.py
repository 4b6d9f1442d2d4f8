"""Fields on another mesh, each in its own way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from solver.fields.bent_meshes import smooth_mesh
from solver.transfers.cases import adapted


def test_each_field_is_carried_in_its_own_way() -> None:
    old, new = smooth_mesh(17), smooth_mesh(21, depth=-0.05)
    step = (old.x > 0.4).astype(float)
    of_cells = np.random.default_rng(2).uniform(0.0, 1.0, (16, 19, 2))
    fields = {
        "smooth": np.sin(old.x),
        "vector": em.MeshValues(np.stack([step, 2 * step], axis=-1), transfer="conservative"),
        "cells": em.MeshValues(of_cells, transfer="conservative", location="cells", bounds=(0.0, 1.0)),
    }
    moved = em.transfer(old, fields, new)
    assert [*moved] == [*fields]
    assert moved["vector"].shape == (21, 24, 2)
    assert moved["cells"].shape == (20, 23, 2)
    assert np.abs(moved["smooth"] - np.sin(new.x)).max() < 1e-4
    assert em.integral(new, moved["vector"][..., 1]) == pytest.approx(2 * em.integral(old, step), rel=1e-14)
    assert np.abs(moved["vector"][..., 1] - 2 * moved["vector"][..., 0]).max() < 1e-14
    for k in range(2):
        whole = em.integral(old, of_cells[..., k], "cells")
        assert em.integral(new, moved["cells"][..., k], "cells") == pytest.approx(whole, rel=1e-14)


def test_on_curved_sides_bounds_come_before_integrals() -> None:
    ring = em.AnnulusSector(angles=(0, 180))
    old, new = adapted("tanh(20*(x + y/2 - 0.75))", 17, ring), adapted("tanh(20*(x + y/2 - 0.35))", 17, ring)
    inner = np.exp(-30.0 * ((old.x - 0.3) ** 2 + (old.y - 1.4) ** 2))
    wall = 1.0 + np.tanh(5.0 * (old.x + old.y - 1.0))
    for values, is_kept in ((inner, True), (wall, True), (np.ones(old.x.shape), False)):
        moved = em.transfer(old, {"u": em.MeshValues(values, transfer="conservative")}, new)["u"]
        assert values.min() <= moved.min()
        assert moved.max() <= values.max()
        before, after = em.integral(old, values), em.integral(new, moved)
        assert (abs(after / before - 1.0) < 1e-13) is is_kept
    of_cells = np.random.default_rng(8).uniform(0.0, 1.0, (16, 16))
    carried = em.transfer(old, {"u": em.MeshValues(of_cells, transfer="conservative", location="cells")}, new)["u"]
    assert em.integral(new, carried, "cells") == pytest.approx(em.integral(old, of_cells, "cells"), rel=1e-13)


@pytest.mark.parametrize("way", ["spline", "conservative"])
def test_both_ways_refuse_other_domains_and_folded_meshes(way: Any) -> None:
    old = smooth_mesh(9)
    fields = {"u": em.MeshValues(np.ones(old.x.shape), transfer=way)}
    for factor in (0.9, 1.0 - 1e-5, 2.0):
        with pytest.raises(InputError, match="between two meshes of one domain"):
            em.transfer(old, fields, em.Mesh(factor * old.x, old.y))
    for x in (old.x[::-1], np.full(old.x.shape, np.nan)):
        with pytest.raises(InputError, match="folded"):
            em.transfer(old, fields, em.Mesh(x, old.y))
    for part in (old.x[:3], old.x[:, :2]):
        with pytest.raises(InputError, match="at least 4 in each direction"):
            em.transfer(old, fields, em.Mesh(part, part))
    assert em.transfer(old, {}, old) == {}


@pytest.mark.parametrize("fields", [[1.0], None, "u"])
def test_fields_without_names_are_refused(fields: Any) -> None:
    mesh = smooth_mesh(9)
    with pytest.raises(SamplesError, match="give them by their names"):
        em.transfer(mesh, fields, mesh)
