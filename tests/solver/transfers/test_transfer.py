"""Fields on another mesh, each in its own way, and where values are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import equimesh as em
from block_cases import in_blocks
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError, SamplesError
from equimesh.meshes.mesh import Mesh
from equimesh.transfers.mesh_values import mesh_values
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.transfer import transfer_nodal, transfer_spline
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, ring, strip, turned
from solver.transfers.cases import adapted, fronts


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


@pytest.mark.parametrize(
    ("old", "new"),
    [(corner(8), bent(corner(8), 0.02)), (bent(disc(6), 0.02), turned(disc(7), 0.2)), (strip(12), strip(9, 0.4, 0.03))],
)
def test_fields_are_carried_between_meshes_of_blocks(old: Mesh, new: Mesh) -> None:
    step, centre = (np.sin(6 * old.x) > 0.2).astype(float), old.points[old.cells].mean(axis=1)[:, 0]
    step[old.ties[:, 0]] = step[old.ties[:, 1]]  # copies have the values of their originals
    averages = (np.sin(6 * centre) > 0.2).astype(float)
    fields = {
        "linear": old.y,
        "vector": em.MeshValues(np.stack([step, 2 * step], axis=-1), transfer="conservative"),
        "cells": em.MeshValues(averages, transfer="conservative", location="cells"),
        "constant": em.MeshValues(np.full(len(old.points), 3.0), transfer="conservative"),
    }
    moved = em.transfer(old, fields, new)
    assert np.abs(moved["linear"] - new.y).max() < 0.01
    assert em.integral(new, moved["vector"][:, 1]) == pytest.approx(2 * em.integral(old, step), rel=1e-14)
    assert em.integral(new, moved["cells"], "cells") == pytest.approx(em.integral(old, averages, "cells"), rel=1e-14)
    for name in ("vector", "cells"):
        assert -1e-15 <= moved[name].min() <= moved[name].max() <= 2.0 + 1e-15
    assert np.abs(moved["vector"][:, 1] - 2 * moved["vector"][:, 0]).max() < 1e-14
    assert np.ptp(moved["constant"]) < 1e-14
    assert np.array_equal(moved["vector"][new.ties[:, 0]], moved["vector"][new.ties[:, 1]])


@pytest.mark.parametrize("make", [corner, ring])
def test_on_blocks_cubics_are_of_third_order_and_conservative_values_of_second(make: Callable[[int], Mesh]) -> None:
    def wave(mesh: Mesh) -> np.ndarray:
        return np.sin(2 * mesh.x + mesh.y)

    errors = []
    for n in (8, 16, 32):
        old, new = make(n), bent(make(n), 0.3 / n)
        moved = em.transfer(old, {"u": wave(old), "c": em.MeshValues(wave(old), transfer="conservative")}, new)
        errors.append([np.abs(values - wave(new)).max() for values in moved.values()])
    for k, falls in ((0, 6.5), (1, 3.0)):
        assert errors[0][k] / errors[1][k] > falls
        assert errors[1][k] / errors[2][k] > falls


def test_values_of_blocks_that_do_not_fit_are_refused() -> None:
    mesh = corner(3)
    with pytest.raises(SamplesError, match=r"u has shape \(27,\).* needed, shape \(40,\); for values of this shape"):
        em.transfer(mesh, {"u": np.zeros(27)}, mesh)
    with pytest.raises(SamplesError, match="u has 17 components"):
        em.transfer(mesh, {"u": np.zeros((40, 17))}, mesh)
    with pytest.raises(SamplesError, match=r"values has shape \(40,\), but an average over each cell .*shape \(27,\)$"):
        em.integral(mesh, np.zeros(40), "cells")


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


# Values at nodes: integrals to rounding, bounds, and the order.


WAVY = em.Expression("sin(3*x + y)*exp(y/2)")


def moved_values(old: em.Mesh, values: np.ndarray, new: em.Mesh) -> np.ndarray:
    rough = transfer_spline(old, {"u": values}, new)["u"]
    return transfer_nodal(Overlaps.of(old, new), values.ravel(), rough.ravel()).reshape(new.node_shape)


def test_the_error_is_of_order_2() -> None:
    errors = []
    for n in (17, 33, 65):
        old, new = smooth_mesh(n), smooth_mesh(n, depth=0.03)
        moved = moved_values(old, WAVY.evaluate(old.x, old.y)[0], new)
        errors.append(np.abs(moved - WAVY.evaluate(new.x, new.y)[0]).max())
    assert np.log2(errors[1] / errors[2]) > 1.9
    assert errors[2] < 3e-4


def test_a_mesh_that_does_not_change_keeps_its_values() -> None:
    mesh, _ = fronts()
    values = np.random.default_rng(4).uniform(0.0, 1.0, mesh.x.shape)
    assert np.abs(moved_values(mesh, values, mesh) - values).max() < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_integral_and_bounds_hold_for_anything(seed: int) -> None:
    old, new = fronts()
    values = np.random.default_rng(seed).integers(0, 2, old.x.shape).astype(float)
    moved = moved_values(old, values, new)
    assert moved.min() >= 0.0
    assert moved.max() <= 1.0
    assert em.integral(new, moved) == pytest.approx(em.integral(old, values), rel=1e-14)


def test_the_integral_is_kept_by_the_parts_and_not_only_by_sharing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.transfers.transfer.share_out", lambda *_: None)
    old, new = fronts()
    values = WAVY.evaluate(old.x, old.y)[0]
    assert em.integral(new, moved_values(old, values, new)) == pytest.approx(em.integral(old, values), rel=1e-13)


def test_fields_go_from_a_grid_to_blocks_and_back() -> None:
    grid, blocks = smooth_mesh(17), in_blocks(smooth_mesh(19, depth=0.02)).mesh
    for old, new in ((grid, blocks), (blocks, grid)):
        u = WAVY.evaluate(old.x, old.y)[0]
        means = np.ones(old.cell_shape)
        fields = {
            "spline": em.MeshValues(np.stack([u, u], axis=-1)),
            "nodes": em.MeshValues(u, transfer="conservative"),
            "cells": em.MeshValues(means, transfer="conservative", location="cells"),
        }
        moved = em.transfer(old, fields, new)
        assert moved["spline"].shape == (*new.node_shape, 2)
        assert np.abs(moved["spline"][..., 1] - WAVY.evaluate(new.x, new.y)[0]).max() < 1e-3
        assert em.integral(new, moved["nodes"]) == pytest.approx(em.integral(old, u), rel=1e-13)
        assert moved["cells"] == pytest.approx(np.ones(new.cell_shape), abs=1e-13)


def test_fields_cross_the_seam_of_closed_lines() -> None:
    ring, grids = em.AnnulusSector(closed=True), [em.Grid(n_xi=7, n_eta=n) for n in (25, 33)]
    old, new = (map_mesh(em.Mesh.uniform(grid), ring) for grid in grids)
    of_nodes, of_cells = np.sin(old.x) * old.y, np.arange(np.prod(old.cell_shape), dtype=float).reshape(old.cell_shape)
    fields = {"u": of_nodes, "q": em.MeshValues(of_cells, transfer="conservative", location="cells")}
    moved = em.transfer(old, fields, new)
    assert np.abs(moved["u"] - np.sin(new.x) * new.y).max() < 0.01
    assert np.array_equal(moved["u"][:, 0], moved["u"][:, -1])
    assert em.integral(new, moved["q"], "cells") == pytest.approx(em.integral(old, of_cells, "cells"), rel=1e-13)
    with pytest.raises(InputError, match="of one domain"):
        em.transfer(old, fields, em.Mesh(1.1 * new.x, new.y, ties=new.ties))


# Values at nodes by splines.


def test_the_components_of_a_vector_are_carried_by_themselves() -> None:
    old, new = smooth_mesh(9), smooth_mesh(12, depth=0.02)
    values = np.stack([np.sin(old.x), old.y**2], axis=-1)
    both = transfer_spline(old, {"v": values}, new)["v"]
    assert both.shape == (12, 15, 2)
    for k in range(2):
        assert np.array_equal(both[..., k], transfer_spline(old, {"u": values[..., k]}, new)["u"])
    assert np.abs(both[..., 0] - np.sin(new.x)).max() < 1e-3


def test_an_array_is_carried_by_splines() -> None:
    field = mesh_values(np.zeros((9, 12)))
    assert (field.transfer, field.location) == ("spline", "nodes")
    assert mesh_values(field) is field


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"transfer": "linear"}, "choose 'spline' or 'conservative'"),
        ({"location": "faces", "transfer": "conservative"}, "choose 'nodes' or 'cells'"),
        ({"location": "cells"}, "averages over cells are carried with their integrals"),
        ({"bounds": (0.0, 1.0)}, "only the conservative transfer keeps bounds"),
        ({"bounds": (1.0, 0.0), "transfer": "conservative"}, "in this order"),
        ({"bounds": 5, "transfer": "conservative"}, "give two numbers"),
        ({"bounds": ("a", "b"), "transfer": "conservative"}, "give two numbers"),
    ],
)
def test_words_that_do_not_fit_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        em.MeshValues(np.zeros((9, 12)), **options)


@pytest.mark.parametrize(
    ("shape", "location", "message"),
    [
        ((8, 11), "nodes", r"needed, shape \(9, 12\), xi first; for values of this shape give location='cells'"),
        ((9, 12), "cells", "give location='nodes'"),
        ((12, 9), "nodes", "transpose it"),
        ((9, 12, 17), "nodes", "17 components"),
    ],
)
def test_values_of_another_shape_are_refused(shape: tuple[int, ...], location: Any, message: str) -> None:
    field = em.MeshValues(np.zeros(shape), transfer="conservative", location=location)
    with pytest.raises(SamplesError, match=message) as caught:
        field.on(smooth_mesh(9), "rho")
    assert caught.value.field == "rho"


def test_lists_of_unequal_lengths_are_refused() -> None:
    with pytest.raises(SamplesError, match="every row must have the same length"):
        em.MeshValues([[1.0, 2.0], [3.0]]).on(smooth_mesh(9), "rho")


def test_values_beyond_their_bounds_or_too_large_are_refused() -> None:
    beyond = em.MeshValues(np.full((9, 12), 2.0), transfer="conservative", bounds=(0.0, 1.0))
    with pytest.raises(SamplesError, match="give bounds that hold"):
        beyond.on(smooth_mesh(9), "rho")
    with pytest.raises(SamplesError, match="rescale"):
        em.MeshValues(np.full((9, 12), 1e300)).on(smooth_mesh(9), "rho")
