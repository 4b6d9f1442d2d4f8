"""Requests for steps of a sequence, and answers to them; without I/O."""

from __future__ import annotations

import hashlib
import io
import json
from typing import Any

import numpy as np
import pytest

from equimesh_client import BadArgument, DownloadDamaged, RetryPolicy, SequenceStep
from equimesh_client.wire import steps
from equimesh_client.wire.arrays import arrays_of
from equimesh_client.wire.deadline import Deadline, Settings
from equimesh_client.wire.protocol import Call, Reply

SETTINGS = Settings(url="http://host", timeout=1.0, policy=RetryPolicy(retries=0))
CELLS = np.array([[0, 2, 3, 1]])


def npz() -> bytes:
    x, y = np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij")
    sides = {name: np.array([[0, 1]]) for name in ("left", "right", "bottom", "top")}
    file = io.BytesIO()
    np.savez(file, x=x, y=y, u=x * y, cells=CELLS, q_eq=np.ones(1), subdomain=np.zeros(1), p=x - y, **sides)
    return file.getvalue()


CURRENT = SequenceStep(number=4, mesh_id="m-4", arrays=arrays_of(npz()))


def request(u: object, fields: Any = None, parameters: Any = None, t: float | None = None) -> Call:
    return steps.step_call("s 1", CURRENT, u, fields, parameters, t)


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


@pytest.mark.parametrize(("fields", "t", "message"), [({"u": [1.0]}, None, "called u"), (None, 1.0, "belong to an")])
def test_arguments_that_cannot_be_sent(fields: Any, t: float | None, message: str) -> None:
    with pytest.raises(BadArgument, match=message):
        request(CURRENT.x, fields, None, t)


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
