"""Monitors of the client: their JSON, and which u goes where."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_client import (
    ArcLength,
    BadArgument,
    Curvature,
    Intersection,
    Quadrilateral,
    Rectangle,
    StoredSamples,
    Tensor,
    Weight,
)
from equimesh_client.spec.monitors import monitor_json

BIG = np.ones((60, 60))


def read(function: object) -> dict[str, Any]:
    return {"expression": function}


X, Y = read("x"), read("y")
# the monitor, the u of `generate`, the JSON
GOOD: list[tuple[Any, Any, dict[str, Any]]] = [
    (ArcLength(), "x", {"kind": "arc_length", "u": X, "a": 0.7, "b": 0.05}),
    (
        ArcLength(a=0.5, smoothing=0.1, u="y"),
        None,
        {"kind": "arc_length", "u": Y, "a": 0.5, "b": 0.05, "smoothing": 0.1},
    ),
    (Curvature(norm="h1"), "x", {"kind": "curvature", "u": X, "norm": "h1", "isotropic": False}),
    (Weight("y"), None, {"kind": "weight", "rho": Y}),
    (Weight("y", smoothing=0.2), "x", {"kind": "weight", "rho": Y, "u": X, "smoothing": 0.2}),
    (Tensor("x", "0", "y"), None, {"kind": "tensor", "m11": X, "m12": read("0"), "m22": Y}),
    ({"kind": "curvature"}, "x", {"kind": "curvature", "u": X}),
    ({"kind": "weight", "rho": X}, None, {"kind": "weight", "rho": X}),
    (
        Intersection([Curvature(), Weight("y"), ArcLength(u="y")]),
        "x",
        {
            "kind": "intersection",
            "monitors": [
                {"kind": "curvature", "u": X, "norm": "l2", "isotropic": False},
                {"kind": "weight", "rho": Y},
                {"kind": "arc_length", "u": Y, "a": 0.7, "b": 0.05},
            ],
        },
    ),
    (
        Intersection([Weight("x"), Weight("y")], smoothing=0.1),
        "x",
        {
            "kind": "intersection",
            "monitors": [{"kind": "weight", "rho": X, "u": X}, {"kind": "weight", "rho": Y}],
            "smoothing": 0.1,
        },
    ),
]


@pytest.mark.parametrize(("monitor", "u", "json"), GOOD)
def test_monitors_as_json(monitor: Any, u: Any, json: dict[str, Any]) -> None:
    assert monitor_json(monitor, read, u) == json


@pytest.mark.parametrize(
    ("monitor", "u", "words"),
    [
        (ArcLength(), None, "give u"),
        (Curvature(), None, "give u"),
        (ArcLength(u="x"), "y", "twice"),
        (Weight("x", u="x"), "y", "twice"),
        ({"kind": "weight", "u": X}, "y", "twice"),
        (Intersection([ArcLength(), Weight("x")]), None, "give u"),
        (Intersection([ArcLength(u="x"), ArcLength(u="y")]), "x", "not used"),
        (Intersection([Intersection([]), Weight("x")]), None, "at the top an Intersection"),
        (Intersection(3), "x", "list of monitors"),  # type: ignore[arg-type]
        ("curvature", "x", "a monitor is"),
    ],
)
def test_what_is_refused(monitor: Any, u: Any, words: str) -> None:
    with pytest.raises(BadArgument, match=words):
        monitor_json(monitor, read, u)


def test_generate_sends_monitor_domain_and_mode(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate(
        "c*x",
        8,
        monitor=Intersection([Curvature(isotropic=True), Weight("c+y")]),
        domain=Rectangle(x=(0, 2)),
        mode="tight",
        allow_relaxed=False,
        parameters={"c": 2},
    )
    sent = client.meshes.get("m0").spec()
    assert sent["monitor"]["monitors"][0]["u"] == {"expression": "c*x", "parameters": {"c": 2.0}}
    assert sent["monitor"]["monitors"][1]["rho"] == {"expression": "c+y", "parameters": {"c": 2.0}}
    assert sent["domain"] == {"kind": "rectangle", "x": [0, 2], "y": [0, 1]}
    assert (sent["mode"], sent["allow_relaxed"]) == ("tight", False)
    client.generate(monitor=Weight("1+x"))
    assert client.meshes.get("m1").spec()["grid"] == {"n_xi": 64, "n_eta": 64}
    assert "domain" not in client.meshes.get("m1").spec()


def test_a_and_b_are_those_of_the_arc_length(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate("x", 8, a=0.5)
    assert client.meshes.get("m0").spec()["monitor"]["a"] == 0.5
    with pytest.raises(BadArgument, match="a and b belong to the arc length"):
        client.generate("x", 8, a=0.5, monitor=Curvature())
    with pytest.raises(BadArgument, match="parameters and t belong to an expression"):
        client.generate(np.ones((3, 3)), 8, t=0.5)
    with pytest.raises(BadArgument, match="give u"):
        client.generate()


def test_one_file_goes_with_the_request_and_several_are_stored_first(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate(monitor=Tensor(BIG, "0", BIG), n=8)
    assert list(parts_of(service.seen("POST", "meshes")[-1])) == ["spec", "samples"]
    sent = client.meshes.get("m0").spec()["monitor"]
    assert sent["m11"] == sent["m22"] == {"samples": "upload"}
    client.generate(monitor=Tensor(BIG, "0", 2 * BIG), n=8)
    sent = client.meshes.get("m1").spec()["monitor"]
    assert {sent["m11"]["samples"], sent["m22"]["samples"]} == set(service.samples)
    client.generate(BIG, 8, monitor=Intersection([Weight(2 * BIG), Curvature()]))
    sent = client.meshes.get("m2").spec()["monitor"]["monitors"]
    assert {sent[0]["rho"]["samples"], sent[1]["u"]["samples"]} == set(service.samples)
    client.generate(StoredSamples(id="s-1", record={}), 8, monitor=Weight(BIG))
    sent = client.meshes.get("m3").spec()["monitor"]
    assert (sent["u"], sent["rho"]) == ({"samples": "s-1"}, {"samples": "upload"})


def test_a_lost_upload_is_sent_again(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/samples", "lose")]
    mesh = connect(service.url).generate(monitor=Tensor(BIG, "0", 2 * BIG), n=8)
    assert (list(service.meshes), len(service.samples)) == ([mesh.id], 2)


def test_functions_are_sampled_on_the_box_of_the_domain(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate(lambda x, y: x + y, 8, n_samples=3, domain=Rectangle(x=(0, 2), y=(3, 4)))
    grid = client.meshes.get("m0").spec()["monitor"]["u"]["grid"]
    assert (grid["x"], grid["y"], grid["values"][2][2]) == ([0, 1, 2], [3, 3.5, 4], 6)
    assert service.seen("POST", "check") == []
    line = [[0, 0], [1, 0]]
    around = Quadrilateral(bottom=line, right=line, top=("t", "1"), left=line)
    for domain in (around, around.json()):
        client.generate(np.ones((3, 2)), 8, domain=domain)
        grid = client.meshes.list(limit=1).__next__().spec()["monitor"]["u"]["grid"]
        assert (grid["x"], grid["y"]) == ([2, 3, 4], [-1, 3])
    asked = len(service.seen("POST", "check"))
    client.generate("x", 8, domain=around)
    assert len(service.seen("POST", "check")) == asked == 2


def test_samples_are_stored_for_a_domain(connect: Any, service: Any) -> None:
    client = connect(service.url)
    first = client.samples.upload(BIG, domain=Rectangle(x=(0, 2)))
    assert first.id != client.samples.upload(BIG).id
    client.check("x", domain=Rectangle(x=(0, 2)))
    assert b'"x": [0.0, 2.0]' in service.seen("POST", "check")[-1].body


def test_a_relaxed_mesh_says_so(connect: Any, service: Any) -> None:
    client = connect(service.url)
    plain = client.generate("x", 8)
    assert (plain.certificate, plain.relaxed, plain.warnings) == (None, False, ())
    mesh = client.generate("x", 8, label="relaxed")
    assert mesh.relaxed
    assert mesh.warnings == ("The mesh adapts less than asked.",)
    assert mesh.certificate.interpolation_gain == {"l2": 5.4, "h1": 2.4}
    assert (mesh.certificate.relaxed[0].what, mesh.certificate.relaxed[0].reached) == ("a", 0.35)
    said = str(mesh.certificate)
    for words in ("relaxed", "a of the arc length: 0.7 requested, 0.35 reached", "5.4 in L2", "warning: The mesh"):
        assert words in said
