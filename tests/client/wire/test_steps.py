"""Requests for steps, answers to them, and the loop around a solver; without I/O."""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from equimesh_client import (
    ArcLength,
    BadArgument,
    BadValues,
    CellAverages,
    Certificate,
    Curvature,
    DownloadDamaged,
    ErrorIndicator,
    Field,
    Intersection,
    RetryPolicy,
    SequenceStep,
    StoredSamples,
    Weight,
)
from equimesh_client.wire import steps
from equimesh_client.wire.adapting import AdaptLoop
from equimesh_client.wire.arrays import MeshArrays, arrays_of
from equimesh_client.wire.protocol import Call, Reply
from equimesh_client.wire.settings import Deadline, Settings
from equimesh_coupling.parts import SIDES

SETTINGS = Settings(url="http://host", timeout=1.0, policy=RetryPolicy(retries=0))
CELLS = np.array([[0, 2, 3, 1]])


def npz(**more: Any) -> bytes:
    x, y = np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij")
    sides = {name: np.array([[0, 1]]) for name in ("left", "right", "bottom", "top")}
    file = io.BytesIO()
    np.savez(file, x=x, y=y, u=x * y, cells=CELLS, q_eq=np.ones(1), subdomain=np.zeros(1), p=x - y, **more, **sides)
    return file.getvalue()


CURRENT = SequenceStep(number=4, mesh_id="m-4", arrays=arrays_of(npz()))


def request(
    u: object, fields: Any = None, parameters: Any = None, t: float | None = None, monitor: Any = None, **motion: Any
) -> Call:
    more: Any = motion
    given = steps.StepArguments(u=u, fields=fields, monitor=monitor, parameters=parameters, t=t, motion=more)
    return steps.step_call("s 1", CURRENT, given)


def test_an_expression_is_sent_as_json() -> None:
    call = request("x + c*t", {"p": CURRENT.x}, {"c": 2.0}, 0.5)
    assert (call.method, call.path, call.headers["Content-Type"]) == (
        "POST",
        "/v1/sequences/s%201/steps",
        "application/json",
    )
    source = {"expression": "x + c*t", "parameters": {"c": 2.0}, "t": 0.5}
    assert json.loads(call.body or b"") == {"step": 4, "u": source, "fields": {"p": [[0.0, 0.0], [1.0, 1.0]]}}


def test_values_and_callables_are_sent_as_equal_npz() -> None:
    values, evaluated = request(CURRENT.x + CURRENT.y), request(lambda x, y: x + y)
    assert values.headers["Content-Type"] == "application/x-npz"
    assert values.headers["Idempotency-Key"] == evaluated.headers["Idempotency-Key"]
    with np.load(io.BytesIO(values.body or b"")) as file:
        assert int(file["step"]) == 4
        np.testing.assert_array_equal(file["u"], [[0.0, 1.0], [1.0, 2.0]])


@pytest.mark.parametrize(
    ("u", "fields", "t", "message"),
    [
        (CURRENT.x, {"u": [1.0]}, None, "called u"),
        (CURRENT.x, None, 1.0, "belong to an"),
        (CURRENT.x, {"p": [[1.0], [2.0, 3.0]]}, None, "p is not an array of real numbers"),
        (None, None, None, "needs u, or a monitor"),
    ],
)
def test_arguments_that_cannot_be_sent(u: Any, fields: Any, t: float | None, message: str) -> None:
    with pytest.raises(BadArgument, match=message):
        request(u, fields, None, t)


def said_in(call: Call) -> tuple[dict[str, Any], dict[str, Any]]:
    """The settings and the arrays of a request in npz."""
    with np.load(io.BytesIO(call.body or b"")) as file:
        return json.loads(file["settings"].item()) if "settings" in file.files else {}, dict(file)


def test_fields_say_how_they_are_carried() -> None:
    fields = {"p": CURRENT.x, "q": Field([[1.0]], "conservative", "cells"), "v": Field(np.ones((2, 2, 2)))}
    settings = {"q": {"transfer": "conservative", "location": "cells"}}
    said, arrays = said_in(request(CURRENT.x, fields))
    assert said == {"fields": settings}
    assert {name: arrays[name].shape for name in "pqv"} == {"p": (2, 2), "q": (1, 1), "v": (2, 2, 2)}
    sent = json.loads(request("x", fields).body or b"")["fields"]
    assert sent["q"] == {"values": [[1.0]], **settings["q"]}
    assert np.shape(sent["p"]) == (2, 2)


def test_plain_steps_are_those_of_the_release_before() -> None:
    file = io.BytesIO()
    np.savez(file, step=np.int64(4), u=CURRENT.x, p=CURRENT.y)
    assert request(CURRENT.x, {"p": Field(CURRENT.y)}).body == file.getvalue()


def test_functions_of_a_monitor_are_values_at_the_nodes() -> None:
    monitor = Intersection(
        [Curvature(u={"field": "p"}, smoothing=0.02), Weight(rho=lambda x, y: 1 + x + 0 * y), ArcLength()]
    )
    said, arrays = said_in(request(None, {"p": CURRENT.x}, monitor=monitor))
    curvature, weight, arc_length = said["monitor"]["monitors"]
    assert (curvature["u"], curvature["smoothing"]) == ({"field": "p"}, 0.02)
    assert "u" not in arc_length
    np.testing.assert_array_equal(arrays[weight["rho"]["nodes"]], 1 + CURRENT.x)
    document = {"kind": "weight", "rho": CURRENT.y, "u": "x"}
    sent = json.loads(request("x + t", None, None, 2.0, monitor=document).body or b"")
    assert sent["monitor"] == {**document, "rho": CURRENT.y.tolist()} | {"rho": {"nodes": CURRENT.y.tolist()}}
    timed, _ = said_in(request(None, None, None, 2.0, monitor=Curvature(u="x + t")))
    assert timed["monitor"]["u"] == {"expression": "x + t", "t": 2.0}
    stored = StoredSamples(id="s-1", record={})
    assert said_in(request(None, monitor=Weight(rho=stored)))[0]["monitor"]["rho"] == {"samples": "s-1"}
    assert said_in(request({"field": "p"}, {"p": CURRENT.x}))[0] == {"u": {"field": "p"}}


def test_how_the_mesh_moves_is_sent_where_it_is_given() -> None:
    motion = {"smoothing": 0.5, "outrun": "refuse"}
    assert said_in(request(CURRENT.x, **motion))[0] == motion
    assert json.loads(request("x", max_move=2).body or b"")["max_move"] == 2.0
    with pytest.raises(TypeError, match="no option 'smooting'; did you mean 'smoothing'"):
        request("x", smooting=0.5)


def advance(reply: Reply) -> SequenceStep:
    """The step in the first answer."""
    flow = steps.advance(request("x"), SETTINGS, Deadline.after(10.0))
    sent = next(flow)
    assert sent.call.headers["Prefer"].startswith("wait=")  # type: ignore[union-attr]
    with pytest.raises(StopIteration) as caught:
        flow.send(reply)
    step: SequenceStep = caught.value.value
    return step


def test_the_step_of_an_answer() -> None:
    body = npz()
    headers = {"equimesh-step": "5", "location": "/v1/meshes/m-5", "etag": f'"{hashlib.sha256(body).hexdigest()}"'}
    step = advance(Reply(status=201, headers=headers, body=body))
    assert (step.number, step.mesh_id, sorted(step.fields)) == (5, "m-5", ["p"])
    np.testing.assert_array_equal(step.u, step.x * step.y)


def test_an_answer_that_names_no_step() -> None:
    with pytest.raises(DownloadDamaged, match="too old for sequences"):
        advance(Reply(status=200, headers={}))


def test_what_a_step_says_of_its_mesh() -> None:
    certificate = {"status": "relaxed", "warnings": ["mind the step"]}
    said = {"status": "succeeded", "certificate": certificate, "warnings": ["mind the step"], "velocity": "velocity"}
    said |= {"substeps": 2, "moved": 0.5}
    moved = np.ones((2, 2, 2))
    body = npz(step_json=np.frombuffer(json.dumps(said).encode(), np.uint8), velocity=moved)
    headers = {"equimesh-step": "5", "location": "/v1/meshes/m-5", "etag": f'"{hashlib.sha256(body).hexdigest()}"'}
    step = advance(Reply(status=201, headers=headers, body=body))
    assert (step.status, step.warnings, sorted(step.fields)) == ("succeeded", ("mind the step",), ["p"])
    assert step.certificate.status == "relaxed"
    assert (step.substeps, step.moved) == (2, 0.5)
    assert step.velocity is not None
    np.testing.assert_array_equal(step.velocity, moved)
    assert (CURRENT.certificate, CURRENT.velocity, CURRENT.warnings, CURRENT.substeps) == (
        None,
        None,
        (),
        None,
    )  # of an earlier release


NUMBER = np.arange(12).reshape(4, 3)
LINES = {"left": NUMBER[0, ::-1], "right": NUMBER[-1], "bottom": NUMBER[:, 0], "top": NUMBER[::-1, -1]}


def arrays(shift: float = 0.0) -> MeshArrays:
    """A mesh of 4 x 3 points of a square of 3 x 2, whose nodes inside are shifted along x."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0), indexing="ij")
    x[1:-1] += shift
    corners = np.stack([NUMBER[:-1, :-1], NUMBER[1:, :-1], NUMBER[1:, 1:], NUMBER[:-1, 1:]], axis=-1)
    sides = {side: np.column_stack([LINES[side][:-1], LINES[side][1:]]) for side in SIDES}
    empty = np.zeros((3, 2))
    return MeshArrays(
        x=x, y=y, u=None, cells=corners.reshape(-1, 4), q_eq=empty, subdomain=empty.astype(np.int64), boundary=sides
    )


def certificate(l2: float, start: str | None = "lines") -> Certificate:
    compared = [{"kind": "nodal_solution", "settings": {"start": start}, "chosen": True}] if start else []
    estimate = {"l2": l2, "h1": 2 * l2, "unresolved": 0.1 * l2, "moved_cells": 3.0}
    return Certificate.from_json({"status": "completed", "estimate": estimate, "comparison": compared})


def loop(**changed: Any) -> AdaptLoop[str]:
    return AdaptLoop(**{"solve": len, "n": (4, 3), "domain": None, "rounds": 5, "norm": "l2", **changed})


def test_the_service_chooses_the_shape_until_a_round_that_resolves_the_solution_keeps_it() -> None:
    one, mesh = loop(n=None, points=30, norm="h1"), arrays()
    assert one.first().request(None).spec["target"]["max_points"] == 30
    answered, other = one.receive(mesh, mesh.x), replace(mesh, x=np.zeros((6, 5)))

    def spec() -> dict[str, Any]:
        request = one.next(answered)
        found: dict[str, Any] = request.request(((0, 3), (0, 2))).spec
        return found

    for l2, after in ((2.0, mesh), (1.0, other), (1.0, mesh)):  # at first 20 % are not resolved
        assert spec()["target"] == {"norm": "h1", "error": None, "max_points": 30}
        assert "grid" not in spec()
        one.add("a round", answered, certificate(l2), after)
    assert spec()["grid"] == {"n_xi": 4, "n_eta": 3}
    assert "target" not in spec()


def test_the_cells_of_blocks_go_with_their_values_where_they_are_chosen() -> None:
    square = {"kind": "blocks", "vertices": {}, "blocks": []}
    mesh = replace(arrays(), x=np.arange(6.0), y=np.arange(6.0) ** 2, blocks={"one": np.arange(6).reshape(3, 2)})
    one = loop(n=None, points=30, domain=square)
    assert one.first().request(None).spec["target"]["max_points"] == 30
    answered = one.receive(mesh, mesh.x)
    for is_settled in (False, True):
        one.is_settled = is_settled
        request = one.next(answered)
        spec = request.request(None).spec
        assert spec["monitor"]["u"]["block_nodes"]["block_cells"] == [[2, 1]]
        assert ("target" in spec, "grid" in spec) == (not is_settled, False)


def test_values_at_nodes_are_sent_with_their_nodes_and_the_certificate_is_taken_over() -> None:
    one, mesh = loop(norm="h1"), arrays()
    values = mesh.x * mesh.y
    answered = one.receive(mesh, values.ravel())
    request = one.next(answered)
    spec = request.request(((0, 3), (0, 2))).spec
    assert spec["grid"] == {"n_xi": 4, "n_eta": 3}
    assert spec["monitor"]["kind"] == "nodal_solution"
    assert spec["monitor"]["norm"] == "h1"
    assert spec["monitor"]["u"]["nodal"]["values"] == values.tolist()
    one.add("first", answered, certificate(1.0), arrays(0.1))
    one.add("second", answered, certificate(0.1, None), arrays())
    assert [record.mesh for record in one.done] == ["first", "second"]
    assert [record.estimate for record in one.done] == [1.0, 0.1]
    assert [record.start for record in one.done] == ["given", "lines"]
    assert [record.moved_cells for record in one.done] == [0.0, 3.0]
    assert (one.start, one.is_done) == ("kept", False)
    assert one.ended().best == 1


def test_an_indicator_becomes_the_weight_of_the_next_mesh() -> None:
    one = loop()
    answered = one.receive(arrays(), ErrorIndicator([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert isinstance(answered.monitor, Weight)
    request = one.next(answered)
    assert request.request(((0, 3), (0, 2))).spec["monitor"]["map"] == "gradient"
    one.add("first", answered, None, arrays(0.25))
    assert one.done[0].estimate == pytest.approx(np.sqrt(91.0))
    assert one.done[0].unresolved is None
    assert (one.start, one.moved_cells) == ("weight", pytest.approx(0.25 * np.sqrt(0.5)))


def test_an_indicator_of_zero_asks_for_no_mesh() -> None:
    one = loop()
    answered = one.receive(arrays(), ErrorIndicator(np.zeros(6)))
    assert one.next(answered) is None
    one.add("first", answered, None, None)
    assert one.is_done


@pytest.mark.parametrize("returned", [np.ones(6), np.full(12, np.nan), np.ones(5), CellAverages(np.ones(5)), "u"])
def test_values_that_cannot_be_used(returned: Any) -> None:
    with pytest.raises(BadValues):
        loop().receive(arrays(), returned)


@pytest.mark.parametrize(
    "changed",
    [
        {"rounds": 0},
        {"rounds": True},
        {"rounds": 101},
        {"norm": "max"},
        {"solve": "tanh(x)"},
        {"points": 30},
        {"n": None, "points": 24},
    ],
)
def test_arguments_that_cannot_be_used(changed: dict[str, Any]) -> None:
    with pytest.raises(BadArgument):
        loop(**changed)
