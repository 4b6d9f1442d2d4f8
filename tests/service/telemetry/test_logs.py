"""Log lines: one JSON object each, with the ids of request, mesh and worker, and without secrets."""

from __future__ import annotations

import json
import logging
import re
from datetime import datetime

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from equimesh_service.telemetry import logs
from equimesh_service.telemetry.log_context import LogContext, enter
from service.conftest import small, until
from service.observed import Observed

SECRET = "em_k1_" + "s" * 43


def test_a_request_is_followed_into_the_worker(observed: Observed) -> None:
    spec = small(label="a private label")
    headers = {"X-Request-Id": "night-7", "Prefer": "wait=300", "X-Api-Key": SECRET}
    answer = httpx.post(f"{observed.url}/v1/meshes?format=vtu", json=spec, headers=headers, timeout=600.0)
    assert (answer.status_code, answer.headers["x-request-id"]) == (201, "night-7")
    mesh = answer.headers["location"].rpartition("/")[2]
    until(lambda: observed.lines(logger="equimesh_service.access", request_id="night-7"))
    loggers = {line["logger"] for line in observed.lines(request_id="night-7", mesh_id=mesh)}
    assert loggers == {f"equimesh_service.{name}" for name in ("access", "admission.computation", "worker.solve")}
    (line,) = observed.lines(logger="equimesh_service.access", request_id="night-7")
    assert (line["method"], line["route"], line["status"]) == ("POST", "/v1/meshes", 201)
    assert (line["bytes"], line["level"], line["mesh_id"]) == (len(answer.content), "info", mesh)
    assert 0 < line["duration"] < 60
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z", line["time"])
    assert abs(datetime.fromisoformat(line["time"]).timestamp() - observed.log.stat().st_mtime) < 60
    text = observed.log.read_text()
    for hidden in ("a private label", "sin(pi*y)", SECRET, "Traceback"):
        assert hidden not in text


def test_probes_and_what_clients_make_up_are_not_in_the_log(observed: Observed) -> None:
    for path in ("/livez", "/readyz", "/metrics", "/a%0apath?q=word"):
        httpx.get(observed.url + path, headers={"X-Request-Id": "un sane", "Authorization": f"Bearer {SECRET}"})
    last = httpx.get(f"{observed.url}/v1/meshes/m-0123abcd", headers={"X-Request-Id": "the-last"})
    assert last.status_code == 404
    until(lambda: observed.lines(request_id="the-last", mesh_id="m-0123abcd", route="/v1/meshes/{id}", status=404))
    text = observed.log.read_text()
    for hidden in ("livez", "readyz", "path?", "word", "un sane", SECRET):
        assert hidden not in text
    assert observed.lines(route="unmatched", status=404)


def line_of(format: str, error: BaseException | None = None) -> str:
    """The line of a record, as it is written."""
    raised = (type(error), error, error.__traceback__) if error is not None else None
    record = logging.LogRecord("here", logging.WARNING, __file__, 1, "it is %s", ("so",), raised)
    return logs.formatter(format).format(record)


def test_both_formats_name_the_trail() -> None:
    with enter(LogContext(request_id="r-1", key_id="k-1")):
        told, text = json.loads(line_of("json")), line_of("text")
    assert (told["message"], told["level"], told["logger"]) == ("it is so", "warning", "here")
    assert (told["request_id"], told["key_id"], "mesh_id" in told) == ("r-1", "k-1", False)
    assert text.endswith(" WARNING here: it is so [request_id=r-1 key_id=k-1]")
    assert "request_id" not in line_of("json")
    assert line_of("text").endswith("it is so")


def test_exceptions_are_told_by_kind_and_place() -> None:
    def broken() -> None:
        try:
            json.loads("a private spec")
        except ValueError as error:
            raise KeyError("a private label") from error

    with pytest.raises(KeyError) as caught:
        broken()
    told = json.loads(line_of("json", caught.value))["exception"]
    assert re.match(r"KeyError at telemetry/test_logs\.py:\d+ broken < ", told)
    assert "; because of JSONDecodeError at json/decoder.py" in told
    for format in ("json", "text"):
        line = line_of(format, caught.value)
        assert "private" not in line
        assert "Traceback" not in line
        assert "\n" not in line or format == "text"
    assert "disk is full" in line_of("json", OSError(28, "the disk is full"))


def test_statements_with_their_values_are_not_told() -> None:
    error = OperationalError("INSERT INTO meshes", {"label": "a private label"}, Exception("database is locked"))
    line = line_of("json", error)
    assert "database is locked" in line
    assert "private" not in line
    assert "INSERT" not in line


def test_a_program_keeps_its_own_log() -> None:
    root, numba = logging.getLogger(), logging.getLogger("numba")
    before = (root.handlers[:], root.level, numba.level)
    assert before[0], "pytest has handlers of its own"
    logs.configure("debug", "json")
    assert (root.handlers, root.level, numba.level) == before
