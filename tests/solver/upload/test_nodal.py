"""Samples at the nodes of a mesh."""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pytest

import equimesh as em
from equimesh.testing.geometries import l_shape
from equimesh.upload.nodal import BlockNodes, block_nodes, is_nodal, nodal_samples
from equimesh.upload.samples import read_samples

NODES = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
ARRAYS = {"x": NODES.x, "y": NODES.y, "values": NODES.x * NODES.y}
BOX = ((0.0, 1.0), (0.0, 1.0))


def npz() -> bytes:
    file = io.BytesIO()
    np.savez(file, **ARRAYS)
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (npz(), "u.npz"),
        (json.dumps({"nodal": {key: value.tolist() for key, value in ARRAYS.items()}}).encode(), "u.json"),
        (json.dumps({key: value.tolist() for key, value in ARRAYS.items()}).encode(), "u.json"),
    ],
)
def test_files_of_them_are_functions_on_the_mesh(data: bytes, name: str) -> None:
    field = read_samples(data, name, box=BOX)
    assert isinstance(field, em.NodalField)
    assert field.mesh.distance(NODES) == 0.0
    assert np.array_equal(field.values, ARRAYS["values"])


def test_axes_with_a_table_are_no_nodes() -> None:
    assert is_nodal(ARRAYS)
    assert not is_nodal({"x": NODES.x[:, 0], "y": NODES.y[0], "values": ARRAYS["values"]})
    assert not is_nodal({"values": ARRAYS["values"]})


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"y": NODES.y.T}, "of one shape, not"),
        ({"x": 2.0 * NODES.x}, "mesh of another domain"),
        ({"values": np.full(NODES.x.shape, np.nan)}, "values"),
        ({"x": NODES.x[::-1]}, "folded"),
    ],
)
def test_what_is_refused(changed: dict[str, np.ndarray], words: str) -> None:
    with pytest.raises(em.InputError, match=words):
        nodal_samples(**{**ARRAYS, **changed}, box=BOX)


def test_values_at_nodes_of_blocks_are_a_function_on_their_domain() -> None:
    blocks = l_shape(60)
    mesh = blocks.mesh
    given = {"nodes": mesh.points, "values": 1.0 + mesh.x - mesh.y}
    file = io.BytesIO()
    np.savez(file, **given)
    listed = json.dumps({"block_nodes": {key: value.tolist() for key, value in given.items()}}).encode()
    for data, name in ((file.getvalue(), "u.npz"), (listed, "u.json")):
        found = read_samples(data, name)
        assert isinstance(found, BlockNodes)
        np.testing.assert_array_equal(found.on(blocks).values, given["values"])
        with pytest.raises(em.SamplesError, match="has its cells"):
            found.evaluate(mesh.x, mesh.y)
    with pytest.raises(em.SamplesError, match="the mesh of this domain has"):
        block_nodes(**given).on(blocks.refined(2))
    with pytest.raises(em.SamplesError, match="another domain"):
        block_nodes(nodes=0.5 * mesh.points, values=given["values"]).on(blocks)
    with pytest.raises(em.InputError, match="folded") as caught:
        block_nodes(nodes=mesh.points[:, ::-1], values=given["values"]).on(blocks)
    assert caught.value.field == "nodes"
    with pytest.raises(em.SamplesError, match="must be a finite number"):
        block_nodes(nodes=mesh.points, values=np.full(len(mesh.points), np.nan))
    with pytest.raises(em.SamplesError, match="a value for each node"):
        block_nodes(nodes=mesh.points, values=given["values"][1:])
    for cells in ([[math.inf, 4]], [[4], [4, 4]], [[2**63, 4]], [[2**70, 4]], [[4.5, 4]], [[0, 4]], "text"):
        with pytest.raises(em.SamplesError) as refused:
            block_nodes(**given, block_cells=cells)
        assert refused.value.field == "block_cells"
