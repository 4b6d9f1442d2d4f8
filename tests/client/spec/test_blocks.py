"""Domains of the client that are meshes of blocks: their JSON, their files, and what is sent for a mesh file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_client import BadArgument, Blocks, LeastError, MeshFile
from equimesh_client.spec.domains import box_around, domain_json, has_own_points, read_domain
from equimesh_client.spec.request import mesh_spec

SQUARE: dict[str, Any] = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 3]}],
}


def test_blocks_are_read_from_json_and_from_arrays() -> None:
    domain = Blocks(vertices={"a": np.zeros(2), "b": (1, 0)}, blocks=({"corners": ("a", "b"), "cells": (4, 3)},))
    assert domain.to_json() == {
        "kind": "blocks",
        "vertices": {"a": [0.0, 0.0], "b": [1, 0]},
        "blocks": [{"corners": ["a", "b"], "cells": [4, 3]}],
        "curves": {},
        "edges": [],
        "joins": [],
        "sides": {},
        "corners": [],
        "refine": 1,
    }
    assert json.loads(json.dumps(domain.to_json())) == domain.to_json()
    whole = read_domain({"kind": "blocks", **SQUARE, "refine": 2})
    assert domain_json(whole) == domain_json(Blocks(**SQUARE, refine=2))
    assert domain_json(read_domain(domain_json(whole))) == domain_json(whole)
    assert box_around(whole) is None


def test_a_file_of_blocks_may_name_files_of_points(tmp_path: Path) -> None:
    (tmp_path / "foil.csv").write_text("0, 0\n0.5, 0.1\n1, 0\n")
    curves = {"foil": {"points": "foil.csv"}, "hole": {"circle": {"radius": 1}}}
    (tmp_path / "blocks.json").write_text(json.dumps({**SQUARE, "curves": curves}))
    sent = Blocks.read(tmp_path / "blocks.json").to_json()["curves"]
    assert sent == {"foil": {"points": [[0, 0], [0.5, 0.1], [1, 0]]}, "hole": {"circle": {"radius": 1}}}
    (tmp_path / "foil.csv").write_text("x, y\nzero, one\n")
    with pytest.raises(BadArgument, match=r"foil\.csv holds no points"):
        Blocks.read(tmp_path / "blocks.json")
    (tmp_path / "foil.csv").unlink()
    with pytest.raises(BadArgument, match=r"foil\.csv: No such file"):
        Blocks.read(tmp_path / "blocks.json")


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "a JSON object"),
        ({"vertices": {}}, "needs blocks"),
        ({**SQUARE, "cells": 3}, "has no cells; it has vertices"),
        ({"kind": "mesh"}, "needs file"),
        ({"kind": "mesh", "file": "s-1", "format": "msh"}, "has no format"),
    ],
)
def test_other_documents_are_refused(document: Any, message: str) -> None:
    with pytest.raises(BadArgument, match=message):
        (read_domain if isinstance(document, dict) and "kind" in document else Blocks.of)(document)


def test_a_spec_on_blocks_has_no_grid() -> None:
    monitor = {"kind": "least_error", "u": {"expression": "x"}}
    for domain in (Blocks(**SQUARE), {"kind": "blocks", **SQUARE}, MeshFile(file="s-1", corners=("te", 4))):
        spec = mesh_spec(monitor, 64, {"domain": domain})
        assert has_own_points(domain)
        assert "grid" not in spec
        assert spec["domain"] == domain_json(domain)
        with pytest.raises(BadArgument, match="leave n out"):
            mesh_spec(monitor, 33, {"domain": domain})
    assert MeshFile(file="s-1", corners=("te", 4)).to_json() == {
        "kind": "mesh",
        "file": "s-1",
        "corners": ["te", 4],
        "corner_angle": None,
    }


def test_a_mesh_file_comes_with_the_request(connect: Any, service: Any, tmp_path: Path) -> None:
    file = tmp_path / "cylinder.msh"
    file.write_bytes(b"$MeshFormat")
    client = connect(service.url)
    client.generate("x", monitor=LeastError(), domain=MeshFile(file=file, corner_angle=30.0))
    assert not service.seen("POST", "samples")
    parts = parts_of(service.seen("POST", "meshes")[-1])
    assert parts["mesh"] == ("cylinder.msh", b"$MeshFormat")
    sent = json.loads(parts["spec"][1])
    assert sent["domain"] == {"kind": "mesh", "file": "upload", "corners": [], "corner_angle": 30.0}
    assert "grid" not in sent
    client.generate("x", domain=MeshFile(file=client.samples.upload_mesh(file).id))
    (upload,) = service.seen("POST", "samples")
    assert upload.query["kind"] == "mesh"
    assert parts_of(upload)["samples"] == ("cylinder.msh", b"$MeshFormat")
    with pytest.raises(BadArgument, match="No such file"):
        client.generate("x", domain=MeshFile(file=tmp_path / "none.msh"))


def test_a_mesh_file_whose_box_is_needed_is_stored_first(connect: Any, service: Any, tmp_path: Path) -> None:
    (tmp_path / "cylinder.msh").write_bytes(b"$MeshFormat")
    connect(service.url).generate(lambda x, y: x + y, domain=MeshFile(file=tmp_path / "cylinder.msh"))
    (stored,) = service.samples
    sent = service.seen("POST", "meshes")[-1]
    text = parts_of(sent)["spec"][1] if sent.headers["content-type"].startswith("multipart") else sent.body
    assert json.loads(text)["domain"]["file"] == stored
