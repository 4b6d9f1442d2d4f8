"""Requests for a mesh: what `generate` sends, for both clients."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_client import (
    BadArgument,
    Curvature,
    Intersection,
    Quadrilateral,
    Rectangle,
    StoredSamples,
    Tensor,
    Weight,
)
from equimesh_client.spec.domains import domain_json

BIG = np.ones((60, 60))


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
    assert sent["domain"] == {"kind": "rectangle", "x": [0, 2], "y": [0, 1], "periodic": None}
    assert (sent["mode"], sent["allow_relaxed"]) == ("tight", False)
    client.generate(monitor=Weight("1+x"))
    assert client.meshes.get("m1").spec()["grid"] == {"n_xi": 64, "n_eta": 64}
    assert "domain" not in client.meshes.get("m1").spec()


def test_a_and_b_are_those_of_the_arc_length(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate("x", 8, a=0.5)
    assert client.meshes.get("m0").spec()["monitor"]["a"] == 0.5
    client.generate("x", 8, b=0.05)
    arc_length = client.meshes.get("m1").spec()["monitor"]
    assert (arc_length["kind"], arc_length["a"], arc_length["b"]) == ("arc_length", 0.7, 0.05)
    client.generate("x", 8)
    assert client.meshes.get("m2").spec()["monitor"] == {"u": {"expression": "x"}}
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


def test_functions_are_sampled_on_the_box_of_the_domain(connect: Any, service: Any) -> None:
    client = connect(service.url)
    client.generate(lambda x, y: x + y, 8, n_samples=3, domain=Rectangle(x=(0, 2), y=(3, 4)))
    grid = client.meshes.get("m0").spec()["monitor"]["u"]["grid"]
    assert (grid["x"], grid["y"], grid["values"][2][2]) == ([0, 1, 2], [3, 3.5, 4], 6)
    assert service.seen("POST", "check") == []
    line = [[0, 0], [1, 0]]
    around = Quadrilateral(bottom=line, right=line, top=("t", "1"), left=line)
    for domain in (around, domain_json(around)):
        client.generate(np.ones((3, 2)), 8, domain=domain)
        grid = client.meshes.list(limit=1).__next__().spec()["monitor"]["u"]["grid"]
        assert (grid["x"], grid["y"]) == ([2, 3, 4], [-1, 3])
    requested = len(service.seen("POST", "check"))
    client.generate("x", 8, domain=around)
    assert len(service.seen("POST", "check")) == requested == 2
