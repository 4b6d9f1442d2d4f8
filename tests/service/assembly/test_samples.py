"""Samples of a spec: on the box of the domain, alone, stored, uploaded, scattered."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import equimesh as em
from equimesh import specs
from equimesh.errors import InputError
from equimesh_service.assembly.samples import MESH, blocks_of, convert_mesh
from service.assembly.specs import DOMAINS, TENSOR
from service.conftest import small
from service.requests import STEP, WAIT, arrays, npz, post, solved


def test_samples_cover_the_box_of_the_domain(http: httpx.Client) -> None:
    x, y = np.linspace(-1, 1, 21), np.linspace(0, 3, 31)
    values = np.tanh(4 * (x[:, None] - y))
    domain = DOMAINS["rectangle"]
    stored = http.post("/v1/samples", files={"samples": ("u.npz", npz(x=x, y=y, values=values))})
    assert stored.status_code == 201, stored.text
    monitor = {"kind": "arc_length", "u": {"samples": stored.json()["id"]}}
    for within in (domain, {"x": [-0.9, 1], "y": [0.1, 2.9]}):
        solved(http, small(monitor=monitor, domain=within))
    wide = {"kind": "rectangle", "x": [-1, 2]}
    refused = http.post("/v1/meshes", json=small(monitor=monitor, domain=wide))
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "/monitor/u/samples/x"
    assert "cover" in refused.json()["errors"][0]["message"]


def test_values_alone_lie_on_the_box_of_the_domain(http: httpx.Client) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.tanh(4 * (np.linspace(-1, 1, 21)[:, None] - np.linspace(0, 3, 31))))
    domain = DOMAINS["rectangle"]
    stored = http.post("/v1/samples?filename=u.npy", content=buffer.getvalue()).json()
    assert stored["shape"] == [21, 31]
    mesh = solved(http, small(monitor={"kind": "arc_length", "u": {"samples": stored["id"]}}, domain=domain))
    exact = solved(http, small(monitor={"kind": "arc_length", "u": {"expression": "tanh(4*(x - y))"}}, domain=domain))
    np.testing.assert_allclose(arrays(http, mesh)["x"], arrays(http, exact)["x"], atol=0.02)


def test_one_upload_and_stored_samples_in_one_monitor(http: httpx.Client) -> None:
    axis = np.linspace(0, 1, 9)
    first = http.post("/v1/samples", files={"samples": ("a.npz", npz(x=axis, y=axis, values=1 + np.outer(axis, axis)))})
    here = first.json()["id"]
    upload = {"samples": "upload"}
    monitor = {
        "kind": "intersection",
        "monitors": [
            {"kind": "tensor", "m11": upload, "m12": {"expression": "0"}, "m22": upload},
            {"kind": "weight", "rho": {"samples": here}, "u": upload},
        ],
    }
    parts = {
        "spec": (None, json.dumps(small(monitor=monitor))),
        "samples": ("b.npz", npz(x=axis, y=axis, values=2 + axis[:, None] + 0 * axis)),
    }
    answer = http.post("/v1/meshes", files=parts, headers=WAIT)
    assert answer.status_code == 201, answer.text
    mesh = answer.json()
    assert mesh["status"] == "succeeded", mesh["error"]
    members = http.get(mesh["links"]["spec"]).json()["monitor"]["monitors"]
    new = members[0]["m11"]["samples"]
    assert new.startswith("s-")
    assert new != here
    assert [members[0]["m22"], members[1]["u"], members[1]["rho"]] == [{"samples": s} for s in (new, new, here)]
    assert solved(http, http.get(mesh["links"]["spec"]).json())["status"] == "succeeded"
    for name in (here, new):
        assert http.delete(f"/v1/samples/{name}").status_code == 204
    gone = http.post("/v1/meshes", json=http.get(mesh["links"]["spec"]).json())
    assert (gone.status_code, gone.json()["errors"][0]["pointer"]) == (422, "/monitor/monitors/0/m11/samples")


def test_scattered_samples_of_a_tensor(http: httpx.Client) -> None:
    rng = np.random.default_rng(3)
    points = np.vstack([rng.random((300, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    scattered = {"scattered": {"points": points.tolist(), "values": (1 + points[:, 0]).tolist()}}
    solved(http, small(monitor={**TENSOR, "m22": scattered}))
    negative = {"scattered": {"points": points.tolist(), "values": (-1 - points[:, 0]).tolist()}}
    refused = http.post("/v1/meshes", json=small(monitor={**TENSOR, "m22": negative}))
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "/monitor/m22")


# Meshes of blocks through the service: described or uploaded, solved, kept, drawn and written to files.


LEAST: dict[str, Any] = {"kind": "least_error", "u": {"expression": "tanh(9*(y - 0.5 - 0.2*x))"}}


@pytest.fixture(scope="module")
def mesh(http: httpx.Client) -> dict[str, Any]:
    """A finished mesh of blocks."""
    return solved(http, {"monitor": LEAST, "domain": STEP})


def test_a_mesh_of_blocks_is_kept(http: httpx.Client, mesh: dict[str, Any]) -> None:
    found = arrays(http, mesh)
    assert (mesh["grid"], mesh["points"]) == (None, found["x"].size)
    assert found["x"].shape == found["u"].shape
    assert found["cells"].shape == (6 * 4 + 2 * 12 * 4, 4)
    assert {name for name in found.files if name.startswith("blocks/")} == {
        f"blocks/{n}" for n in ("block0", "upper", "block2")
    }
    outlet = found["sides/outlet"]
    np.testing.assert_allclose(found["x"][outlet], 2.0)
    assert mesh["certificate"]["interpolation_gain"]["l2"] > 1.2
    assert mesh["convergence"]["status"] == "completed"
    spec = http.get(mesh["links"]["spec"]).json()
    assert (spec["grid"], spec["domain"]["refine"]) == (None, 1)
    again = solved(http, spec)
    np.testing.assert_array_equal(arrays(http, again)["x"], found["x"])


def test_its_results(http: httpx.Client, mesh: dict[str, Any]) -> None:
    links = mesh["links"]
    quality = http.get(links["quality"], params={"arrays": "true"}).json()
    assert len(quality["q_eq"]["cells"]) == 120
    history = http.get(links["convergence"]).json()["descent"]
    assert history[-1]["points"] == mesh["points"]
    table = http.get(links["convergence"], params={"format": "csv"}).text.splitlines()
    assert len(table) == len(history) + 1
    for kind in ("mesh", "quality", "comparison", "convergence"):
        picture = http.get(links["plot"], params={"kind": kind, "format": "svg"})
        assert picture.status_code == 200, picture.text
    for form in ("vtu", "msh", "foam", "su2"):
        assert http.get(links["file"], params={"format": form}).status_code == 200
    refused = http.get(links["file"], params={"format": "vts"})
    assert (refused.status_code, "blocks" in refused.json()["detail"]) == (406, True)
    refused = post(http, {"monitor": LEAST, "domain": STEP}, "?format=vts", **WAIT)
    assert refused.status_code == 406
    drawing = np.load(io.BytesIO(http.get(links["self"] + "/drawing").content))
    document = json.loads(drawing["document"].tobytes())
    assert [block["shape"] for block in document["blocks"]] == [[7, 5], [13, 5], [13, 5]]
    assert drawing["x"].shape == drawing["uniform_x"].shape == (7 * 5 + 2 * 13 * 5,)
    assert drawing["error"].shape == (120,)
    assert "than on the initial mesh" in document["sentences"][0]["text"]
    found = arrays(http, mesh)
    np.testing.assert_array_equal(drawing["x"][35:100], found["x"][found["blocks/upper"]].ravel())


def test_a_mesh_that_was_uploaded_is_a_domain(http: httpx.Client, mesh: dict[str, Any]) -> None:
    file = http.get(mesh["links"]["file"], params={"format": "msh"}).content
    upload = {"params": {"kind": "mesh", "filename": "step.msh"}, "content": file}
    stored = http.post("/v1/samples", **upload)
    assert stored.status_code == 201, stored.text
    info = stored.json()
    assert (info["kind"], info["shape"], info["min"]) == (MESH, [mesh["points"], 120], None)
    assert {"inlet", "outlet", "step"} <= {*info["sides"]}
    assert http.post("/v1/samples", **upload).json()["id"] == info["id"]
    domain = {"kind": "mesh", "file": info["id"]}
    found = arrays(http, solved(http, {"monitor": LEAST, "domain": domain}))
    assert found["x"].size == mesh["points"]
    np.testing.assert_allclose(found["x"][found["sides/outlet"]], 2.0)
    report = http.post("/v1/expressions/check", json={"expression": "x", "domain": domain}).json()
    assert report["domain"]["box"] == [[-1, 2], [0, 1]]
    drawing = http.post("/v1/previews", json={"monitor": LEAST, "domain": domain})
    assert drawing.status_code == 200
    for spec, pointer in (
        ({"monitor": {"kind": "arc_length", "u": {"samples": info["id"]}}}, "/monitor/u/samples"),
        ({"monitor": LEAST, "domain": {**domain, "corners": ["nose"]}}, "/domain/corners/0"),
    ):
        answer = post(http, spec)
        assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, pointer)
    samples = http.post("/v1/samples?filename=u.csv", content="x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,2\n").json()["id"]
    answer = post(http, {"monitor": LEAST, "domain": {"kind": "mesh", "file": samples}})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/domain/file")
    begun = http.post("/v1/sequences", json={"monitor": LEAST, "domain": domain}, headers=WAIT).json()
    rows = [[x] for x in arrays(http, {"links": begun["links"]})["x"].tolist()]
    step = http.post(begun["links"]["steps"], json={"step": 0, "u": {"nodes": rows}}, headers=WAIT).json()
    assert (step["step"], np.shape(step["velocity"])) == (1, (mesh["points"], 1, 2))


def test_the_file_of_a_mesh_comes_with_the_spec(http: httpx.Client, mesh: dict[str, Any]) -> None:
    file = http.get(mesh["links"]["file"], params={"format": "msh"}).content
    named = {"monitor": LEAST, "domain": {"kind": "mesh", "file": "upload"}}
    form = {"data": {"spec": json.dumps(named)}, "files": {"mesh": ("step.msh", file)}}
    stored = http.post("/v1/samples", params={"kind": "mesh", "filename": "step.msh"}, content=file).json()["id"]
    made = http.post("/v1/meshes", headers=WAIT, **form).json()
    spec = http.get(made["links"]["self"] + "/spec").json()
    assert (made["status"], made["points"], spec["domain"]["file"]) == ("succeeded", mesh["points"], stored)
    sampled = {**named, "monitor": {"kind": "least_error", "u": {"samples": "upload"}}}
    u = b"x,y,u\n-1,0,0\n-1,1,1\n2,0,1\n2,1,2\n"
    small = io.BytesIO()  # read in the process that answers
    steps = np.arange(9.0)
    np.savez(small, x=np.linspace(-1, 2, 9), y=np.linspace(0, 1, 9), values=np.add.outer(steps, steps))
    for samples in (("u.csv", u), ("u.npz", small.getvalue())):
        both = {"data": {"spec": json.dumps(sampled)}, "files": {**form["files"], "samples": samples}}
        assert solved(http, {}, json=None, **both)["points"] == mesh["points"]
    drawing = http.post("/v1/previews", **form)
    assert drawing.status_code == 200, drawing.text
    for spec, files, message in (
        (named, {"samples": ("step.msh", file)}, 'parts "spec" and "mesh"'),
        ({"monitor": LEAST}, form["files"], 'refer to it with {"kind": "mesh", "file": "upload"}'),
        (named, {"mesh": ("t.stl", b"solid")}, "there are .msh"),
    ):
        answer = http.post("/v1/meshes", data={"spec": json.dumps(spec)}, files=files)
        assert (answer.status_code, message in answer.text.replace('\\"', '"')) == (422, True), answer.text


def test_the_cells_of_blocks_are_chosen_for_a_number_of_points(http: httpx.Client) -> None:
    u = "tanh(30*(y - 0.3))"
    made = solved(http, {"monitor": {"kind": "least_error", "u": u}, "domain": STEP, "grid": {"points": 150}})
    target, monitor = em.Target(max_points=150), em.LeastError(u=em.Expression(u))
    expected = em.solve_to(target, monitor=monitor, domain=em.Blocks.of(STEP))
    found = arrays(http, made)
    np.testing.assert_allclose(np.column_stack([found["x"], found["y"]]), expected.mesh.points, rtol=0.0, atol=1e-8)
    shapes = [found["blocks/block0"].shape, found["blocks/upper"].shape, found["blocks/block2"].shape]
    assert made["blocks"] == [[i - 1, j - 1] for i, j in shapes]
    assert made["blocks"][1][0] < 2 * made["blocks"][2][1]  # the front is level
    assert (made["grid"], made["points"]) == (None, found["x"].size)
    canonical = http.get(made["links"]["self"] + "/spec").json()
    assert (canonical["grid"], canonical["target"]["max_points"]) == (None, 150)
    assert solved(http, canonical)["blocks"] == made["blocks"]


def test_the_iteration_between_blocks_is_that_of_the_solver(http: httpx.Client) -> None:
    schwarz = {"groups": [["block0", "upper"], [2]], "overlap": 3}
    spec = {"monitor": LEAST, "domain": STEP, "schwarz": schwarz}
    made = solved(http, spec)
    canonical = http.get(made["links"]["self"] + "/spec").json()["schwarz"]
    assert {key: canonical[key] for key in schwarz} == schwarz
    problem = specs.build(spec).problem
    in_process = em.solve(problem, em.Schwarz(groups=[["block0", "upper"], [2]], overlap=3))
    found = arrays(http, made)
    np.testing.assert_array_equal(found["x"], in_process.mesh.x)
    descent = http.get(made["links"]["self"] + "/convergence").json()["descent"]
    assert len(descent) == len(in_process.descent)
    drawing = np.load(io.BytesIO(http.get(made["links"]["self"] + "/drawing").content))
    assert json.loads(drawing["document"].tobytes())["ordering"] is None
    assert http.post("/v1/previews", json=spec).status_code == 200
    begun = http.post("/v1/sequences", json=spec)
    assert (begun.status_code, begun.json()["errors"][0]["pointer"]) == (422, "/schwarz")


def test_bad_meshes_are_refused(http: httpx.Client) -> None:
    triangles = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n"
    triangles += "$Elements\n1\n1 2 2 0 1 1 2 3\n$EndElements\n"
    for name, content, message in (
        ("t.msh", triangles, "Recombine"),
        ("t.msh", "$Mesh", ""),
        ("t.msh", " ", "the file is empty"),
        ("t.json", json.dumps({**STEP, "side": {}}), "'side' that is not known"),
        ("t.stl", "solid", "there are .msh"),
        ("t.json", "[", "line 1"),
    ):
        answer = http.post("/v1/samples", params={"kind": "mesh", "filename": name}, content=content)
        assert answer.status_code == 422, answer.text
        assert message in answer.json()["detail"]
        assert answer.json()["errors"][0]["pointer"] == ""


def test_a_description_is_kept_as_it_is(tmp_path: Path) -> None:
    source = tmp_path / "sent"
    source.write_text(json.dumps(STEP))
    summary = convert_mesh(source, "step.json", tmp_path / "kept.npz", 1000)
    blocks = blocks_of(tmp_path / "kept.npz", {})
    assert summary == {"kind": MESH, "shape": [blocks.points, 120], "sides": ["inlet", "outlet", "step"]}
    np.testing.assert_array_equal(blocks.mesh.points, em.Blocks.of(STEP).mesh.points)
    with pytest.raises(InputError, match="has its own corners"):
        blocks_of(tmp_path / "kept.npz", {"corner_angle": 20.0})
    with pytest.raises(InputError, match="takes at most 20"):
        convert_mesh(source, "step.json", tmp_path / "kept.npz", 20)


def test_a_long_name_is_stored_once(tmp_path: Path) -> None:
    n = 300
    points = "\n".join(f"{i} {j}" for i in range(n) for j in (0, 1))
    cells = "\n".join(f"9 {2 * i} {2 * i + 2} {2 * i + 3} {2 * i + 1}" for i in range(n - 1))
    names = ["x" * 100, *(f"s{i}" for i in range(1, n - 1))]
    sides = "\n".join(f"MARKER_TAG= {name}\nMARKER_ELEMS= 1\n3 {2 * i} {2 * i + 2}" for i, name in enumerate(names))
    source, stored = tmp_path / "mesh.su2", tmp_path / "stored.npz"
    source.write_text(f"NDIME= 2\nNELEM= {n - 1}\n{cells}\nNPOIN= {2 * n}\n{points}\nNMARK= {n - 1}\n{sides}\n")
    assert convert_mesh(source, "mesh.su2", stored, 10_000)["sides"][1:3] == ["s1", "s2"]
    with np.load(stored) as arrays:
        assert sum(array.nbytes for array in arrays.values()) < 3 * source.stat().st_size


def test_a_mesh_that_an_earlier_release_stored_is_read(tmp_path: Path) -> None:
    arrays = {
        "points": np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
        "cells": np.array([[0, 1, 2, 3]]),
        "names": np.array(["wall"]),
        "side_0": np.array([[0, 1]]),
        "place_names": np.array(["te"]),
        "places": np.array([2]),
    }
    np.savez(tmp_path / "old.npz", **arrays)
    assert "wall" in blocks_of(tmp_path / "old.npz", {}).mesh.sides
