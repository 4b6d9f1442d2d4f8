"""The archive of a drawing, and what it says of failed and folded meshes."""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

import numpy as np

import equimesh as em
from equimesh.quality import compare_with_uniform
from equimesh_service.worker.drawing import arrays_of, document_of, norm_of, pack
from equimesh_service.worker.summary import summary_of

SPEC: dict[str, Any] = {"monitor": {"kind": "arc_length"}, "target": None}
U = em.Expression("tanh(9*(x - y))")


def solution() -> em.Solution:
    return em.solve(em.Problem(monitor=em.ArcLength(u=U), grid=em.Grid(n_xi=9, n_eta=8)), em.Schwarz(overlap=2))


def test_an_archive_is_read_by_numpy_and_not_compressed() -> None:
    arrays = {"x": np.arange(6.0).reshape(2, 3).T, "u": np.ones((2, 2), dtype=np.float32)}
    content = pack({"text": "ξ", "none": None}, arrays)
    with np.load(io.BytesIO(content), allow_pickle=False) as found:
        assert json.loads(found["document"].tobytes()) == {"text": "ξ", "none": None}
        for name, values in arrays.items():
            assert np.array_equal(found[name], values)
            assert found[name].dtype == values.dtype
            assert found[name].flags.c_contiguous
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}
    assert content == pack({"text": "ξ", "none": None}, arrays)


def test_a_folded_mesh_leaves_the_uniform_one() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=6, n_eta=5))
    mesh.x[2, 2] = 0.9
    monitor = em.Problem(monitor=em.ArcLength(u=U), grid=mesh.grid).monitor
    compared = compare_with_uniform(mesh, monitor)
    names = {"x", "y", "u", "q_eq", "error"}
    assert arrays_of(compared, is_folded=True).keys() == {f"uniform_{name}" for name in names}
    assert arrays_of(compared, is_folded=False).keys() == names | {f"uniform_{name}" for name in names}


def test_a_document_is_plain_json_also_where_a_solve_failed() -> None:
    solved = solution()
    error = {"title": "Mesh folded", "detail": "A cell is inverted.", "remedy": "Add points."}
    result = {"solution": summary_of(solved), "certificate": solved.certificate.summary(), "quality": None}
    mesh, parts = solved.mesh, solved.decomposition
    spec = {**SPEC, "schwarz": {"ordering": "parallel"}}
    document = document_of(spec, result, error=error, convergence=None, decomposition=parts, mesh=mesh)
    assert json.loads(json.dumps(document, allow_nan=False))["status"] == "failed"
    assert document["sentences"][0]["tone"] == "bad"
    assert document["subdomains"] == [{"xi": [0, 5], "eta": [0, 7]}, {"xi": [4, 8], "eta": [0, 7]}]
    plain = document_of(SPEC, result, error=None, convergence=None, decomposition=None, mesh=mesh)
    assert (plain["status"], plain["subdomains"], plain["ordering"]) == ("succeeded", None, None)


def test_the_norm_is_that_of_the_target_or_of_the_monitor() -> None:
    monitor = {"kind": "curvature", "norm": "h1"}
    assert norm_of({"monitor": monitor}) == "h1"
    assert norm_of({"monitor": monitor, "target": {"norm": "l2"}}) == "l2"
    assert norm_of({"monitor": {"kind": "weight"}, "target": None}) == "l2"
