"""What may be requested of a mesh in parts, and which meshes are computed so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from equimesh_schema.monitors import MONITORS
from equimesh_service import Settings
from equimesh_service.admission.admit import NO_PARTS, assign_parts
from equimesh_service.problems.problem import Problem
from equimesh_service.spec.mesh import read_spec

U = {"expression": "x*y"}
CURVATURE = {"kind": "curvature", "u": U}
SMALL, LARGE = {"n_xi": 10, "n_eta": 10}, {"n_xi": 50, "n_eta": 50}


def settings(folder: Path, **more: Any) -> Settings:
    cluster = {"engine": "dask", "scheduler": "tcp://127.0.0.1:1"}
    return Settings(**{"data_dir": folder, "max_points": 1000, "max_cluster_points": 5000, **cluster, **more})


@pytest.mark.parametrize(
    ("grid", "parts", "expected"),
    [(SMALL, None, None), (LARGE, None, "auto"), (SMALL, 2, 2), (SMALL, "auto", "auto"), (LARGE, 3, 3)],
)
def test_which_meshes_are_in_parts(tmp_path: Path, grid: Any, parts: Any, expected: Any) -> None:
    spec = read_spec({"monitor": CURVATURE, "grid": grid, "parts": parts})
    assert assign_parts(spec, settings(tmp_path)).canonical["parts"] == expected


@pytest.mark.parametrize("more", [{"engine": "processes", "scheduler": ""}, {"max_cluster_points": 0}])
def test_without_a_cluster_none_is(tmp_path: Path, more: dict[str, Any]) -> None:
    here = settings(tmp_path, **more)
    assert assign_parts(read_spec({"monitor": CURVATURE, "grid": LARGE}), here).canonical["parts"] is None
    with pytest.raises(Problem, match="meshes in parts need a cluster") as caught:
        assign_parts(read_spec({"monitor": CURVATURE, "grid": SMALL, "parts": 2}), here)
    assert [fault.pointer for fault in caught.value.errors] == ["/parts"]


@pytest.mark.parametrize(
    ("change", "pointer", "words"),
    [
        *(({"monitor": {"kind": kind, "u": U}}, "/monitor/kind", "curvature") for kind in NO_PARTS),
        ({"monitor": {"u": U}}, "/monitor/kind", "auto compares whole meshes"),
        ({"schwarz": {}}, "/schwarz", "leave schwarz out"),
        ({"monitor": {"kind": "weight", "rho": U, "map": "gradient"}}, "/monitor/map", "take the map lines"),
        ({"monitor": {**CURVATURE, "orthogonality": 50}}, "/monitor/orthogonality", "leave orthogonality out"),
        (
            {"monitor": {"kind": "intersection", "monitors": [CURVATURE, {**CURVATURE, "orthogonality": 50}]}},
            "/monitor/monitors/1/orthogonality",
            "leave orthogonality out",
        ),
        ({"initial": "uniform"}, "/initial", "nested"),
        ({"cells": "triangle"}, "/cells", "take the cells quad"),
    ],
)
def test_what_a_mesh_in_parts_cannot_have(tmp_path: Path, change: dict[str, Any], pointer: str, words: str) -> None:
    document = {"monitor": CURVATURE, "grid": LARGE, **change}
    with pytest.raises(Problem, match="request at most 1000 points, which one machine computes") as caught:
        assign_parts(read_spec(document), settings(tmp_path))
    assert [fault.pointer for fault in caught.value.errors] == [pointer]
    assert words in caught.value.errors[0].message
    small = read_spec({**document, "grid": SMALL})
    assert assign_parts(small, settings(tmp_path)) is small
    with pytest.raises(Problem, match="or leave parts out"):
        assign_parts(read_spec({**document, "grid": SMALL, "parts": 2}), settings(tmp_path))


def test_a_target_has_no_parts(tmp_path: Path) -> None:
    with pytest.raises(Problem, match="give a grid in place of the target") as caught:
        assign_parts(read_spec({"monitor": CURVATURE, "target": {"error": 1}, "parts": "auto"}), settings(tmp_path))
    assert caught.value.errors[0].pointer == "/target"


def test_every_monitor_that_is_a_metric_may_be_in_parts(tmp_path: Path) -> None:
    assert {*NO_PARTS} < {*MONITORS.documents}
    metrics: list[dict[str, Any]] = [
        CURVATURE,
        {"kind": "arc_length", "u": U},
        {"kind": "weight", "rho": U},
        {"kind": "tensor", "m11": U, "m12": U, "m22": U},
        {"kind": "intersection", "monitors": [CURVATURE, CURVATURE]},
    ]
    assert {metric["kind"] for metric in metrics} | {*NO_PARTS} == {*MONITORS.documents}
    for metric in metrics:
        spec = assign_parts(read_spec({"monitor": metric, "grid": LARGE}), settings(tmp_path))
        assert spec.canonical["parts"] == "auto"


@pytest.mark.parametrize("parts", [0, -1, 2.5, "many", 5000, True])
def test_a_number_of_parts(parts: Any) -> None:
    with pytest.raises(Problem, match="this must be a whole number from 1 to 4096, 'auto' or null") as caught:
        read_spec({"monitor": CURVATURE, "parts": parts})
    assert caught.value.errors[0].pointer == "/parts"


def test_meshes_in_other_parts_are_other_meshes() -> None:
    documents = [{"monitor": CURVATURE, "parts": parts} for parts in (None, 2, 3, "auto")]
    digests = {read_spec(document).points_digest for document in documents}
    assert len(digests) == 4
    plain = read_spec({"monitor": CURVATURE})
    assert plain.points_digest == read_spec(documents[0]).points_digest
