"""Requests for a mesh: what `generate` sends, for both clients."""

from __future__ import annotations

from typing import Any, get_type_hints

import numpy as np
import pytest

import equimesh_client
import equimesh_schema
from client.fake_service import parts_of
from equimesh_client import (
    ArcLength,
    Auto,
    BadArgument,
    Curvature,
    Intersection,
    LeastError,
    LinearRobin,
    Quadrilateral,
    Rectangle,
    Schwarz,
    StoredSamples,
    Target,
    Tensor,
    Weight,
)
from equimesh_client.spec.domains import domain_json
from equimesh_client.spec.request import DEFAULTS, MeshOptions, mesh_spec, monitor_json, points_per_side

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


# Options of a mesh, and the spec that is made of them.


def test_a_spec_with_all_defaults() -> None:
    assert mesh_spec({"kind": "weight"}, 64) == {
        "monitor": {"kind": "weight"},
        "grid": {"n_xi": 64, "n_eta": 64},
        "boundary": "trace",
        "initial": "nested",
        "schwarz": None,
        "cells": "quad",
    }


def test_every_option_has_a_type_and_a_default() -> None:
    assert get_type_hints(MeshOptions).keys() == DEFAULTS.keys()


def test_an_unknown_option_names_the_nearest(connect: Any, service: Any) -> None:
    client = connect(service.url)
    for method, option, words in (
        (client.generate, "points", r"has no option 'points'; give target=Target\(max_points=\.\.\.\)"),
        (client.generate, "bounday", r"generate\(\) has no option 'bounday'; did you mean 'boundary'\?"),
        (client.generate, "deadlin", "did you mean 'deadline'"),
        (client.generate, "xyz", "it has monitor, domain, a, b, "),
        (client.generate, "degree", r"it is a setting of monitor, as in monitor=Auto\(degree=\.\.\.\)"),
        (client.generate, "overlap", r"as in schwarz=Schwarz\(overlap=\.\.\.\)"),
        (client.sequences.start, "kep", "did you mean 'keep'"),
        (client.sequences.start, "initial", "has no option 'initial'"),
    ):
        with pytest.raises(TypeError, match=words):
            method("x", 8, **{option: 1})
    assert service.requests == []


@pytest.mark.parametrize("n", [0.5, "a", None, (1, 2, 3), (4, 4.5), "12"])
def test_n_is_a_number_or_a_pair(n: Any) -> None:
    with pytest.raises(BadArgument, match=r"schwarz is a Schwarz, such as .*; not 4"):
        mesh_spec({"kind": "arc_length"}, 9, {"schwarz": 4})  # type: ignore[typeddict-item]
    with pytest.raises(BadArgument, match="n is the number of points"):
        points_per_side(n)


def test_n_may_come_from_numpy() -> None:
    assert points_per_side(np.int64(5)) == (5, 5)
    assert points_per_side((np.int32(5), 6)) == (5, 6)


def test_a_target_takes_the_place_of_the_grid() -> None:
    spec = mesh_spec({}, 64, {"target": Target(error=1e-4, norm="h1")})
    assert "grid" not in spec
    assert spec["target"] == {"norm": "h1", "error": 1e-4, "max_points": None}
    assert mesh_spec({}, 64, {"target": {"error": 1}})["target"] == {"error": 1}
    with pytest.raises(BadArgument, match="takes the place of n"):
        mesh_spec({}, 65, {"target": Target(error=1e-4)})


# Monitors of the client: their JSON, and which u goes where.


def read(function: object) -> dict[str, Any]:
    return {"expression": function}


X, Y = read("x"), read("y")
# the monitor, the u of `generate`, the JSON
GOOD: list[tuple[Any, Any, dict[str, Any]]] = [
    (Auto(), "x", {"kind": "auto", "u": X, "norm": "l2"}),
    (
        LeastError(norm="h1", smoothness=0.3, u="y"),
        None,
        {"kind": "least_error", "u": Y, "norm": "h1", "distortion": 0.5, "smoothness": 0.3},
    ),
    (ArcLength(), "x", {"kind": "arc_length", "u": X, "a": 0.7, "b": 0.05}),
    (
        ArcLength(a=0.5, smoothing=0.1, u="y"),
        None,
        {"kind": "arc_length", "u": Y, "a": 0.5, "b": 0.05, "smoothing": 0.1},
    ),
    (ArcLength(scaled=False), "x", {"kind": "arc_length", "u": X, "a": 0.7, "b": 0.05, "scaled": False}),
    (Curvature(norm="h1"), "x", {"kind": "curvature", "u": X, "norm": "h1", "isotropic": False}),
    (Weight("y"), None, {"kind": "weight", "rho": Y, "map": "lines"}),
    (
        Weight("y", smoothing=0.2, map="gradient"),
        "x",
        {"kind": "weight", "rho": Y, "u": X, "map": "gradient", "smoothing": 0.2},
    ),
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
                {"kind": "weight", "rho": Y, "map": "lines"},
                {"kind": "arc_length", "u": Y, "a": 0.7, "b": 0.05},
            ],
        },
    ),
    (
        Intersection([Weight("x"), Weight("y")], smoothing=0.1),
        "x",
        {
            "kind": "intersection",
            "monitors": [
                {"kind": "weight", "rho": X, "u": X, "map": "lines"},
                {"kind": "weight", "rho": Y, "map": "lines"},
            ],
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
        (Auto(), None, "Auto needs a function u"),
        (LeastError(u="x"), "y", "twice"),
        (Intersection([ArcLength(), Auto()]), "x", "at the top an Auto"),  # type: ignore[list-item]
        (ArcLength(u="x"), "y", "twice"),
        (Weight("x", u="x"), "y", "twice"),
        ({"kind": "weight", "u": X}, "y", "twice"),
        (Intersection([ArcLength(), Weight("x")]), None, "give u"),
        (Intersection([ArcLength(u="x"), ArcLength(u="y")]), "x", "not used"),
        (Intersection([Intersection([]), Weight("x")]), None, "a NodalSolution or an Intersection"),
        (Intersection(3), "x", "list of monitors"),  # type: ignore[arg-type]
        ("curvature", "x", "a monitor is"),
    ],
)
def test_what_is_refused(monitor: Any, u: Any, words: str) -> None:
    with pytest.raises(BadArgument, match=words):
        monitor_json(monitor, read, u)


# Schwarz settings of the client, and their JSON.


def test_schwarz_as_json() -> None:
    schwarz = mesh_spec({}, 8, {"schwarz": Schwarz(transmission=LinearRobin(2.3), tolerance=None)})["schwarz"]
    assert schwarz == {
        "subdomains": [2, 1],
        "overlap": 4,
        "transmission": {"kind": "linear_robin", "p": 2.3},
        "ordering": "parallel",
        "line_correction": "auto",
        "acceleration": "auto",
        "local_solver": "sweeps",
        "fallback": True,
        "tolerance": None,
        "max_iterations": 100,
        "compare_single_domain": False,
    }
    assert mesh_spec({}, 8, {"schwarz": {"overlap": 3}})["schwarz"] == {"overlap": 3}
    assert Schwarz(subdomains=((24, 40), 1)).to_json()["subdomains"] == [[24, 40], 1]


def test_the_iteration_between_blocks_as_json() -> None:
    schwarz = mesh_spec({}, options={"schwarz": Schwarz(groups=(("in", 2), ("top",)))}, n=8)["schwarz"]
    assert schwarz["groups"] == [["in", 2], ["top"]]
    assert "groups" not in mesh_spec({}, options={"schwarz": Schwarz()}, n=8)["schwarz"]
    for module in (equimesh_client, equimesh_schema):
        with pytest.raises(AttributeError, match=f"{module.__name__}.BlockSchwarz is {module.__name__}.Schwarz now"):
            _ = module.BlockSchwarz
    with pytest.raises(BadArgument, match="schwarz is a Schwarz"):
        mesh_spec({}, 8, {"schwarz": 3})  # type: ignore[typeddict-item]


def test_what_is_no_condition_is_refused() -> None:
    wrong = Schwarz(transmission="classical")  # type: ignore[arg-type]
    with pytest.raises(BadArgument, match=r"transmission = 'classical': give one of Optimized\(\), Classical\(\), L"):
        mesh_spec({}, 8, {"schwarz": wrong})
