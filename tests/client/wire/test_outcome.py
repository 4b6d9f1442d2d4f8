"""The outcome of a request: an exception, or a mesh for meshio."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import MeshCanceled, MeshFailed


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


def test_a_failed_mesh_says_why(connect: Any, service: Any) -> None:
    with pytest.raises(MeshFailed) as caught:
        connect(service.url).generate("x", 5, label="fail")
    assert str(caught.value) == "mesh m0 failed: Mesh folded. At cell 3. Lower a"
    assert caught.value.mesh.status == "failed"


def test_a_canceled_mesh_is_not_waited_for(connect: Any, service: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    assert mesh.cancel().status == "canceled"
    with pytest.raises(MeshCanceled):
        mesh.wait()


def test_to_meshio_names_the_sides(connect: Any, service: Any) -> None:
    meshio = pytest.importorskip("meshio")
    made = connect(service.url).generate("x", (5, 4)).to_meshio()
    assert isinstance(made, meshio.Mesh)
    assert [(block.type, len(block.data)) for block in made.cells] == [
        ("quad", 12),
        ("line", 3),
        ("line", 3),
        ("line", 4),
        ("line", 4),
    ]
    assert set(made.cell_sets) == {"left", "right", "bottom", "top"}
    assert [len(part) for part in made.cell_sets["top"]] == [0, 0, 0, 0, 4]
