"""What may be requested of a mesh in parts, its formats, and when two requests are equal."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest

import equimesh as em
from equimesh_schema.monitors import MONITORS
from equimesh_service import Settings
from equimesh_service.admission import admit, tasks
from equimesh_service.admission.admit import NO_PARTS, assign_parts
from equimesh_service.admission.callers import ANYONE
from equimesh_service.admission.formats import check_format, check_head, check_part, check_whole, known_format
from equimesh_service.assembly.samples import convert_mesh
from equimesh_service.assembly.upload import Upload
from equimesh_service.errors import TimeLimitError
from equimesh_service.files.address import files_address
from equimesh_service.problems.problem import Problem
from equimesh_service.spec.mesh import read_spec
from equimesh_service.worker.job import Storage
from refusals import STEP
from service.requests import npz

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


WHOLE, PARTED = {"parts": None, "cells": "quad"}, {"parts": "auto", "cells": "quad"}


def test_formats_that_fit() -> None:
    check_format("vtu", WHOLE)
    check_format("pvtu", PARTED)
    check_part("npz")
    assert [known_format(name) for name in ("vtu", "pvtu", "npz")] == ["vtu", "pvtu", "npz"]


def test_formats_that_do_not() -> None:
    with pytest.raises(Problem, match="A pvtu file is the head of a mesh in parts, and this mesh is whole"):
        check_format("pvtu", WHOLE)
    with pytest.raises(Problem, match=r"A mesh in parts is no npz file\. Request one of pvtu, vtkhdf"):
        check_format("npz", PARTED)
    with pytest.raises(Problem, match="A vts file holds no triangles"):
        check_format("vts", {**WHOLE, "cells": "triangle"})
    with pytest.raises(
        Problem,
        match=r"holds cells of order 1\. Request one of vtu, hdf, msh, abaqus, hohqmesh, re2, specfem, or order=1",
    ):
        check_whole("su2", "quad", order=2)
    with pytest.raises(Problem, match=r"in parts hold cells of order 1\. Request order=1"):
        check_head("pvtu", order=2)
    with pytest.raises(Problem, match=r"'vtu' is not a format of parts; .*did you mean 'pvtu'"):
        check_part("vtu")
    with pytest.raises(Problem, match=r"'xyz' is not a mesh format; there are vtu, .*pvtu"):
        known_format("xyz")
    for suffix, name in (("inp", "abaqus"), ("MESH", "medit")):
        with pytest.raises(Problem, match=f"did you mean '{name}'"):
            known_format(suffix)


def test_a_retry_may_meet_a_newer_release(monkeypatch: pytest.MonkeyPatch) -> None:
    admitted = tasks.AdmittedSpec({"label": None, "cells": "quad"}, {}, "digest")
    request, points = admitted.fingerprint("vtu"), admitted.points_fingerprint
    monkeypatch.setattr(tasks, "_VERSION", "next")
    assert admitted.fingerprint("vtu") == request
    assert admitted.points_fingerprint != points  # its points may be other ones


@pytest.mark.parametrize(
    ("function", "remedy"), [(convert_mesh, "send a mesh with fewer cells"), (print, "send fewer samples")]
)
def test_what_takes_too_long_has_a_remedy_for_what_was_sent(function: Any, remedy: str) -> None:
    class SlowWorkers:
        def submit(self, *_arguments: Any, **_limits: Any) -> NoReturn:
            raise TimeLimitError("the time limit was reached")

    admission: Any = SimpleNamespace(side_workers=SlowWorkers(), while_waiting=lambda _: nullcontext())
    with pytest.raises(Problem) as caught:
        admit.ServiceAdmission.work(admission, "/domain/file", function)
    assert remedy in str(caught.value.detail)


def test_a_round_of_too_many_points_is_refused_again(tmp_path: Path) -> None:
    class AtOnce:
        def submit(self, _: str, function: Any, *arguments: Any, time_limit: float) -> Any:  # noqa: ARG002
            return SimpleNamespace(result=lambda: function(*arguments))

    here = Settings(data_dir=tmp_path, max_points=200)  # the cells of the domain have fewer
    storage = Storage(here.database, files_address(here))
    store, files = storage.store(), storage.files()
    store.prepare()
    files.prepare(alone=True)
    workers: Any = AtOnce()
    admission = admit.ServiceAdmission(here, store, files, side_workers=workers, while_waiting=lambda _: nullcontext())
    mesh = em.Blocks.of(STEP).refined(2).mesh
    cells = [[n - 1 for n in block.shape] for block in mesh.blocks]
    values = npz(nodes=mesh.points, values=mesh.x, block_cells=np.array(cells))
    row = admission.keep(Upload(data=values, filename="u.npz"), ANYONE)[0]
    monitor = {"kind": "nodal_solution", "u": {"samples": row.id}}
    for _ in range(2):
        with pytest.raises(Problem) as caught:
            admission.admit({"monitor": monitor, "domain": STEP}, None, ANYONE)
        assert caught.value.errors[0].pointer == "/monitor/u"
        assert f"{mesh.x.size} points" in caught.value.errors[0].message


def test_a_spec_that_comes_again_is_read_once_and_checked_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = Settings(data_dir=tmp_path)
    storage = Storage(here.database, files_address(here))
    storage.store().prepare()
    body = json.dumps({"monitor": {"u": "x + y"}, "grid": {"n_xi": 20, "n_eta": 20}, "label": str(tmp_path)}).encode()
    admission = admit.Admission(here, storage.store(), storage.files())
    first = admission.receive(body, None, ANYONE)
    monkeypatch.setattr(admit, "parse", None)
    again = admission.receive(body, None, ANYONE)
    assert (again.spec, again.digest) == (first.spec, first.digest)
    smaller = replace(admission, settings=here.model_copy(update={"max_points": 100}))
    with pytest.raises(Problem) as caught:
        smaller.receive(body, None, ANYONE)
    assert caught.value.errors[0].pointer == "/grid"
