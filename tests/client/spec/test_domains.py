"""Domains of the client: their JSON, their boxes, and what is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_client import AnnulusSector, BadArgument, Blocks, LeastError, MeshFile, Quadrilateral, Rectangle
from equimesh_client.spec.domains import box_around, domain_json, has_own_points, read_domain
from equimesh_client.spec.request import mesh_spec

ROUND = Quadrilateral(
    bottom=("1+t", "0"),
    right=("2*cos(a*t)", "2*sin(a*t)", {"a": 1.5}),
    top=[[0.0, 1.0], [0.0, 2.0]],
    left=np.array([[1.0, 0.0], [0.7, 0.7], [0.0, 1.0]]),
)


def test_domains_as_json() -> None:
    assert domain_json(Rectangle(x=(-1, 2))) == {"kind": "rectangle", "x": [-1, 2], "y": [0, 1], "periodic": None}
    assert domain_json(AnnulusSector(angles=(0, 45))) == {
        "kind": "annulus_sector",
        "center": [0, 0],
        "radii": [1, 2],
        "angles": [0, 45],
        "closed": False,
    }
    assert domain_json(ROUND) == {
        "kind": "quadrilateral",
        "bottom": {"x": "1+t", "y": "0"},
        "right": {"x": "2*cos(a*t)", "y": "2*sin(a*t)", "parameters": {"a": 1.5}},
        "top": {"points": [[0, 1], [0, 2]]},
        "left": {"points": [[1, 0], [0.7, 0.7], [0, 1]]},
        "closed": False,
    }
    assert domain_json({"kind": "rectangle"}) == {"kind": "rectangle"}


@pytest.mark.parametrize("domain", [Rectangle(x=(0, 3)), AnnulusSector(center=(1, 2)), ROUND])
def test_json_is_read_back(domain: Any) -> None:
    assert domain_json(read_domain(domain_json(domain))) == domain_json(domain)


@pytest.mark.parametrize("angles", [(0, 90), (-30, 30), (10, 80), (80, 300), (0, 360), (-200, -100), (630, 700)])
def test_the_box_of_a_sector_holds_it_and_no_more(angles: tuple[float, float]) -> None:
    domain = AnnulusSector(center=(5, -1), radii=(0.5, 2), angles=angles)
    turn = np.radians(np.linspace(*angles, 20_001))
    x, y = 5 + np.outer([0.5, 2], np.cos(turn)), -1 + np.outer([0.5, 2], np.sin(turn))
    box = box_around(domain)
    assert box is not None
    (x0, x1), (y0, y1) = box
    assert np.allclose((x0, x1, y0, y1), (x.min(), x.max(), y.min(), y.max()), atol=1e-7)
    assert x0 <= x.min() + 1e-12
    assert y1 >= y.max() - 1e-12


def test_boxes_agree_with_the_solver() -> None:
    em = pytest.importorskip("equimesh")
    for center, radii, angles in (((0, 0), (1, 2), (0, 90)), ((3, 4), (0.1, 7), (-100, 200.5))):
        ours = box_around(AnnulusSector(center=center, radii=radii, angles=angles))
        theirs = em.AnnulusSector(center=center, radii=radii, angles=angles).box
        assert ours is not None
        assert np.allclose(ours, theirs, rtol=0, atol=1e-14 * math.hypot(*center, 7) * 10)
    assert box_around(ROUND) is None


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: domain_json(Rectangle(x=(0, 1, 2))), "x of a domain is a pair"),  # type: ignore[arg-type]
        (lambda: domain_json(AnnulusSector(radii="ab")), "radii of a domain is a pair"),  # type: ignore[arg-type]
        (lambda: domain_json("disk"), "a domain is a Rectangle"),  # type: ignore[arg-type]
        (lambda: has_own_points(3), "or MeshFile of equimesh_client, or its JSON; not 3"),  # type: ignore[arg-type]
        (lambda: domain_json(Quadrilateral(bottom="t", right=0, top=0, left=0)), "bottom is a pair of formulas"),
        (lambda: domain_json(Quadrilateral(bottom=[[0, math.nan]], right=0, top=0, left=0)), "bottom is a pair"),
        (lambda: read_domain([]), "JSON object"),
        (lambda: read_domain({"kind": "disk"}), "unknown kind of domain 'disk'; there are rectangle"),
        (lambda: read_domain({"kind": "rectangle", "z": 1}), "has no z; it has x, y, periodic"),
        (lambda: read_domain({"blocks": []}), 'has no blocks; a rectangle has none: add "kind": "blocks"'),
        (lambda: read_domain({"x": 3}), "pair of numbers"),
        (lambda: read_domain({"periodic": "z"}), "periodic of a domain is one of None, 'x', 'y', 'both'"),
        (lambda: read_domain({"kind": "annulus_sector", "closed": 1}), "closed of a domain is one of False, True"),
        (lambda: read_domain({"kind": "quadrilateral", "left": {"points": []}}), "needs bottom, right, top"),
        (lambda: read_domain({**domain_json(ROUND), "left": [[0, 0]]}), "left must be"),
        (lambda: read_domain({**domain_json(ROUND), "closed": 1}), "closed of a domain is one of False, True"),
    ],
)
def test_what_is_refused(make: Any, words: str) -> None:
    with pytest.raises(BadArgument, match=words):
        make()


def test_closed_lines_as_json_and_back() -> None:
    for domain, closed in (
        (Rectangle(periodic="both"), {"periodic": "both"}),
        (AnnulusSector(closed=True), {"closed": True, "angles": [0, 360]}),
    ):
        document = domain_json(domain)
        assert closed.items() <= document.items()
        assert read_domain(document) == domain
    around = domain_json(replace(ROUND, closed=True))
    assert around["closed"] is True
    assert domain_json(read_domain(around)) == around
    assert read_domain({"kind": "annulus_sector", "closed": True}) == AnnulusSector(closed=True)


# Domains of the client that are meshes of blocks: their JSON, their files, and what is sent for a mesh file.


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
        "fixed": [],
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
    with pytest.raises(BadArgument, match=r"'a.msh' looks like the name of a file: give pathlib.Path\('a.msh'\)"):
        client.generate("x", domain=MeshFile(file="a.msh"))


def test_a_mesh_file_whose_box_is_needed_is_stored_first(connect: Any, service: Any, tmp_path: Path) -> None:
    (tmp_path / "cylinder.msh").write_bytes(b"$MeshFormat")
    connect(service.url).generate(lambda x, y: x + y, domain=MeshFile(file=tmp_path / "cylinder.msh"))
    (stored,) = service.samples
    sent = service.seen("POST", "meshes")[-1]
    text = parts_of(sent)["spec"][1] if sent.headers["content-type"].startswith("multipart") else sent.body
    assert json.loads(text)["domain"]["file"] == stored
