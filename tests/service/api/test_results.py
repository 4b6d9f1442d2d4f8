"""Results over HTTP: the mesh file in every format, quality, convergence, pictures, the spec."""

from __future__ import annotations

import hashlib
import io
import xml.etree.ElementTree as ET
import zipfile
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh.io.write import FORMATS
from service.conftest import small
from service.requests import WAIT, post, solved


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("cells", ["quad", "triangle"])
def test_every_format(http: httpx.Client, finished: dict[str, Any], format: str, cells: str) -> None:
    answer = http.get(finished["links"]["file"], params={"format": format, "cells": cells})
    if cells not in FORMATS[format].cells:
        assert answer.status_code == 406
        assert answer.json()["detail"] == (f"A {format} file holds no triangles. Request cells=quad or another format.")
        asked = post(http, small(cells=cells), f"?format={format}")
        assert (asked.status_code, asked.json()["detail"]) == (406, answer.json()["detail"])
        return
    assert answer.status_code == 200
    form = FORMATS[format]
    assert answer.headers["content-type"] == form.media_type
    assert answer.headers["content-disposition"] == f'attachment; filename="equimesh-{finished["id"]}{form.suffix}"'
    by_accept = http.get(finished["links"]["file"], params={"cells": cells}, headers={"Accept": form.media_type})
    assert by_accept.content == answer.content
    if format == "npz":
        corners = np.load(io.BytesIO(answer.content))["cells"].shape[1]
        assert corners == {"quad": 4, "triangle": 3}[cells]
    elif format == "xdmf":
        names = zipfile.ZipFile(io.BytesIO(answer.content)).namelist()
        assert {"mesh.xdmf", "mesh.h5", "facets.xdmf", "facets.h5"} <= set(names)
    elif format in ("msh", "su2"):
        assert b"left" in answer.content


def test_cells_of_second_order_have_nodes_on_the_curve(http: httpx.Client) -> None:
    mesh = solved(http, small(domain={"kind": "annulus_sector"}))
    url = mesh["links"]["file"]
    text = http.get(url, params={"format": "msh", "order": 2}).text
    assert text != http.get(url, params={"format": "msh"}).text
    rows = text.split("$Nodes\n")[1].split("$EndNodes")[0].splitlines()[1:]
    radius = np.hypot(*np.array([row.split()[1:3] for row in rows], dtype=float).T)
    assert (abs(radius - 1) < 1e-12).sum() == (abs(radius - 2) < 1e-12).sum() == 2 * 9 - 1
    refused = http.get(url, params={"format": "su2", "order": 2})
    assert (refused.status_code, refused.json()["detail"]) == (
        406,
        "A su2 file holds cells of order 1. Request one of vtu, hdf, msh, abaqus, hohqmesh, re2, specfem, or order=1.",
    )
    assert http.get(url, params={"order": 3}).status_code == 422


def test_a_mesh_whose_cells_fold_in_second_order_is_refused_with_the_remedy(http: httpx.Client) -> None:
    bottom = {"x": "t", "y": "0.28*sin(3*pi*t)^2"}  # 0 at all nodes
    sides = {"right": {"points": [[1, 0], [1, 0.3]]}, "left": {"points": [[0, 0], [0, 0.3]]}}
    domain = {"kind": "quadrilateral", "bottom": bottom, "top": {"points": [[0, 0.3], [1, 0.3]]}, **sides}
    monitor = {"kind": "arc_length", "u": {"expression": "1"}}
    mesh = solved(http, small(monitor=monitor, grid={"n_xi": 4, "n_eta": 4}, domain=domain))
    refused = http.get(mesh["links"]["file"], params={"format": "vtu", "order": 2})
    assert refused.status_code == 422
    assert "folds where its side bends: take more cells along this side, or order 1" in refused.text


def test_files_can_be_cached_and_resumed(http: httpx.Client, finished: dict[str, Any]) -> None:
    url = finished["links"]["file"]
    whole = http.get(url)
    etag = whole.headers["etag"]
    assert etag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert whole.headers["vary"] == "Accept"
    for named in (etag, f'"other", W/{etag}', "*"):
        same = http.get(url, headers={"If-None-Match": named})
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
    assert http.get(url, headers={"If-None-Match": '"other"'}).status_code == 200
    head = http.head(url)
    assert (head.status_code, head.content) == (200, b"")
    assert int(head.headers["content-length"]) == len(whole.content)
    part = http.get(url, headers={"Range": "bytes=10-19", "If-Range": etag})
    assert (part.status_code, part.content) == (206, whole.content[10:20])
    changed = http.get(url, headers={"Range": "bytes=10-19", "If-Range": '"other"'})
    assert (changed.status_code, changed.content) == (200, whole.content)


def test_formats_that_are_not_there(http: httpx.Client, finished: dict[str, Any]) -> None:
    url = finished["links"]["file"]
    for answer in (
        http.get(url, params={"format": "stl"}),
        http.get(url, headers={"Accept": "image/gif"}),
        http.get(url, headers={"Accept": "application/vnd.vtk.vtu+xml;q=0"}),
        post(http, small(), "?format=stl"),
        http.get(finished["links"]["plot"], headers={"Accept": "image/gif"}),
        http.get(finished["links"]["convergence"], headers={"Accept": "image/gif"}),
        http.get(finished["links"]["events"], headers={"Accept": "image/gif"}),
    ):
        assert answer.status_code == 406
        assert answer.headers["content-type"] == "application/problem+json"


def test_quality_and_its_arrays(http: httpx.Client, finished: dict[str, Any]) -> None:
    quality = http.get(finished["links"]["quality"]).json()
    assert quality == finished["quality"]
    arrays = http.get(finished["links"]["quality"], params={"arrays": True}).json()
    cells = np.array(arrays["q_eq"]["cells"])
    assert cells.shape == (7, 8)
    assert cells.max() == pytest.approx(quality["q_eq"]["max"], rel=1e-14)


def test_convergence_as_json_and_csv(http: httpx.Client, finished: dict[str, Any]) -> None:
    url = finished["links"]["convergence"]
    convergence = http.get(url).json()
    assert convergence["iterations"][0]["iteration"] == 0
    assert convergence["iterations"][-1]["iteration"] == finished["convergence"]["iterations"]
    rows = http.get(url, headers={"Accept": "text/csv"}).text.splitlines()
    columns = rows[0].split(",")
    first = convergence["iterations"][0]
    assert set(columns) == {*first, *first["subdomains"][0]} - {"subdomains"}
    assert len(rows) == 1 + 2 * len(convergence["iterations"])


@pytest.mark.parametrize("kind", ["mesh", "convergence", "quality", "comparison"])
def test_pictures(http: httpx.Client, finished: dict[str, Any], kind: str) -> None:
    svg = http.get(finished["links"]["plot"], params={"kind": kind})
    assert svg.headers["content-type"].startswith("image/svg+xml")
    assert ET.fromstring(svg.content).tag.endswith("svg")
    assert (b"mismatch of the subdomains" in svg.content) == (kind == "convergence")
    gain = finished["certificate"]["interpolation_gain"]["l2"]
    told = (
        f"interpolation error {gain:.3g} times smaller"
        if gain > 1
        else f"interpolation error {1 / gain:.3g} times larger"
    )
    assert (told.encode() in svg.content) == (kind == "comparison")


def test_a_picture_is_a_png_on_request(http: httpx.Client, finished: dict[str, Any]) -> None:
    png = http.get(finished["links"]["plot"], params={"kind": "mesh"}, headers={"Accept": "image/png"})
    assert (png.status_code, png.content[:4]) == (200, b"\x89PNG")


def test_the_spec_comes_back_complete_and_gives_the_same_mesh(http: httpx.Client, finished: dict[str, Any]) -> None:
    spec = http.get(finished["links"]["spec"]).json()
    assert spec["schwarz"]["transmission"] == {"kind": "optimized", "data": "line_sums"}
    assert (spec["boundary"], spec["initial"], spec["label"]) == ("trace", "nested", "finished")
    again = post(http, spec, **WAIT).json()
    assert again["id"] != finished["id"]
    first, second = (http.get(mesh["links"]["file"], params={"format": "npz"}) for mesh in (finished, again))
    assert first.headers["etag"] == second.headers["etag"]


def test_the_errors_of_the_paper_come_when_asked_for(http: httpx.Client) -> None:
    spec = small(schwarz={"overlap": 2, "compare_single_domain": True})
    mesh = post(http, spec, **WAIT).json()
    last = http.get(mesh["links"]["convergence"]).json()["iterations"][-1]
    assert last["error"] < 1e-9
    assert last["subdomains"][0]["error_x"] < 1e-9
