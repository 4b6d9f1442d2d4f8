"""Requests and answers as plain values, and what they look like as words."""

from __future__ import annotations

import json
import pickle
from email.parser import BytesParser
from typing import Any, get_type_hints

import numpy as np
import pytest

from equimesh_client import (
    ArcLength,
    BadArgument,
    Classical,
    Convergence,
    Forbidden,
    Gone,
    InputProblem,
    InvalidInput,
    LinearRobin,
    NotFound,
    Optimized,
    ProblemError,
    Quality,
    QuotaExceeded,
    RateLimited,
    Schwarz,
    ServerError,
    StorageFull,
    TooLarge,
    Unauthorized,
    Upload,
)
from equimesh_client.errors import EquimeshClientError, caret
from equimesh_client.records.tables import align, number
from equimesh_client.spec.mesh import DEFAULTS, MeshOptions, mesh_spec, points_per_side
from equimesh_client.spec.request import MeshRequest
from equimesh_client.spec.schwarz import transmission
from equimesh_client.wire.protocol import (
    Call,
    Reply,
    at_pointer,
    check_expression,
    create_mesh,
    format_of,
    get_mesh,
    json_bytes,
    mesh_of,
    mesh_plot,
    multipart,
    problem_of,
    sha256_of,
)

CALL = Call(method="GET", path="/")


def reply(status: int, body: Any, **headers: str) -> Reply:
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    return Reply(status=status, headers=headers, body=data)


def test_a_spec_with_all_defaults() -> None:
    assert mesh_spec({"kind": "weight"}, 64) == {
        "monitor": {"kind": "weight"},
        "grid": {"n_xi": 64, "n_eta": 64},
        "boundary": "trace",
        "initial": "nested",
        "schwarz": None,
        "cells": "quad",
    }


def test_a_spec_with_other_options() -> None:
    spec = mesh_spec({}, 8, {"domain": {"kind": "rectangle"}, "mode": "tight", "allow_relaxed": False, "label": "mine"})
    assert [spec[name] for name in ("domain", "mode", "allow_relaxed", "label")] == [
        {"kind": "rectangle"},
        "tight",
        False,
        "mine",
    ]


def test_every_option_has_a_type_and_a_default() -> None:
    assert get_type_hints(MeshOptions).keys() == DEFAULTS.keys()
    assert (DEFAULTS["a"], DEFAULTS["b"]) == (ArcLength.a, ArcLength.b)


def test_an_unknown_option_names_the_nearest(connect: Any, service: Any) -> None:
    client = connect(service.url)
    for method, option, words in (
        (client.generate, "bounday", r"generate\(\) has no option 'bounday'; did you mean 'boundary'\?"),
        (client.generate, "deadlin", "did you mean 'deadline'"),
        (client.generate, "xyz", "it has monitor, domain, a, b, "),
        (client.sequences.start, "kep", "did you mean 'keep'"),
        (client.sequences.start, "initial", "has no option 'initial'"),
    ):
        with pytest.raises(TypeError, match=words):
            method("x", 8, **{option: 1})
    assert service.requests == []


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


@pytest.mark.parametrize("n", [0.5, "a", None, (1, 2, 3), (4, 4.5), "12"])
def test_n_is_a_number_or_a_pair(n: Any) -> None:
    with pytest.raises(BadArgument, match="n is the number of points"):
        points_per_side(n)


def test_n_may_come_from_numpy() -> None:
    assert points_per_side(np.int64(5)) == (5, 5)
    assert points_per_side((np.int32(5), 6)) == (5, 6)


def test_transmission_by_name() -> None:
    assert transmission("classical") == Classical()
    assert transmission("linear_robin", 2.0) == LinearRobin(2.0)
    assert transmission("optimized", data="local") == Optimized("local")
    for kind, p, data in (("classical", 1.0, None), ("linear_robin", None, "local"), ("robin", None, None)):
        with pytest.raises(BadArgument):
            transmission(kind, p, data)


def test_json_cannot_carry_nan() -> None:
    with pytest.raises(BadArgument, match="JSON"):
        json_bytes({"b": float("nan")})
    with pytest.raises(BadArgument, match="JSON"):
        json_bytes({"b": object()})
    sent = {"b": np.float64(0.5), "n": np.int64(3), "x": np.ones(2)}
    assert json_bytes(sent) == b'{"b": 0.5, "n": 3, "x": [1.0, 1.0]}'


def test_multipart_is_what_parsers_read_and_the_same_each_time() -> None:
    parts = {"spec": Upload(filename="", data=b"{}"), "samples": Upload(filename='a"b\r\n.npz', data=b"\r\n--x\0")}
    kind, body = multipart(parts)
    assert multipart(parts) == (kind, body)
    message = BytesParser().parsebytes(b"Content-Type: " + kind.encode() + b"\r\n\r\n" + body)
    found = message.get_payload()
    assert [p.get_param("name", header="content-disposition") for p in found] == ["spec", "samples"]
    assert found[1].get_payload(decode=True) == b"\r\n--x\0"
    assert found[1].get_filename() == "a%22b%0D%0A.npz"


def test_an_id_stays_inside_its_segment() -> None:
    assert get_mesh("../x?y").path == "/v1/meshes/..%2Fx%3Fy"


def test_the_calls_of_a_create() -> None:
    request = MeshRequest(spec={"a": 1}, uploads=(), key="k")
    call = create_mesh(request, wait=0)
    assert call.headers == {
        "Accept": "application/json",
        "Idempotency-Key": "k",
        "Content-Type": "application/json",
    }
    assert create_mesh(request, wait=5).headers["Prefer"] == "wait=5"
    assert check_expression("x", {"c": 1.0}, 2.0).sent == {"expression": "x", "parameters": {"c": 1.0}, "t": 2.0}
    with pytest.raises(BadArgument, match="svg or png"):
        mesh_plot("m", "mesh", "gif")


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        *((401, Unauthorized), (403, Forbidden), (404, NotFound), (410, Gone), (413, TooLarge)),
        *((422, InvalidInput), (429, RateLimited), (507, StorageFull), (599, ServerError)),
    ],
)
def test_each_status_has_its_exception(status: int, kind: type[ProblemError]) -> None:
    error = problem_of(reply(status, {"type": "/problems/p", "title": "T", "detail": "D.", "remedy": "R."}), CALL)
    assert type(error) is kind
    assert isinstance(error, EquimeshClientError)
    assert (error.status, error.type, error.title, error.detail) == (status, "/problems/p", "T", "D.")
    assert str(error) == f"T: D (HTTP {status})\n{kind.advice or 'R.'}"


def test_a_quota_is_known_by_its_type_and_says_when_to_come_back() -> None:
    body = {"type": "/problems/quota-exceeded", "title": "T", "detail": "D"}
    error = problem_of(reply(429, body, **{"retry-after": "7"}), CALL)
    assert isinstance(error, QuotaExceeded)
    assert isinstance(error, RateLimited)
    assert str(error).splitlines()[-1] == "Try again in 7 s."


@pytest.mark.parametrize("body", [b"<html>", b"", b"[]", b"null", b"\xff", b'{"errors": 3, "detail": [1]}'])
def test_a_failure_with_any_body_is_a_problem(body: bytes) -> None:
    assert "Bad Gateway" in str(problem_of(reply(502, body), CALL))


def test_a_redirect_names_the_address() -> None:
    error = problem_of(reply(308, b"", location="https://there"), CALL)
    assert "https://there" in str(error)


def test_errors_replace_the_detail_and_show_a_caret_where_there_is_text() -> None:
    place = {"offset": 4, "line": 1, "column": 5}
    errors = [
        {"pointer": "/monitor/u/expression", "message": "unknown name", "position": place},
        {"pointer": "", "parameter": "limit", "message": "too large"},
        "nonsense",
    ]
    sent = {"monitor": {"u": {"expression": "1 + foo"}}}
    error = problem_of(reply(422, {"title": "T", "detail": "D", "errors": errors}), Call(method="", path="", sent=sent))
    assert str(error) == (
        "T (HTTP 422)\n  /monitor/u/expression: unknown name\n      1 + foo\n          ^\n  limit: too large"
    )
    assert [e.pointer for e in error.errors] == ["/monitor/u/expression", "limit"]


def test_the_caret_knows_lines_tabs_and_the_end() -> None:
    assert caret("a\n\tb + c", line=2, column=4) == "    \tb + c\n    \t  ^"
    assert caret("ab", line=1, column=3) == "    ab\n      ^"
    for line, column in ((3, 1), (1, 0), (0, 1)):
        assert caret("ab", line=line, column=column) == ""
    assert str(InputProblem(pointer="", message="m")) == "m"


def test_pointers() -> None:
    document = {"a": [{"b/c": 1, "~": 2}]}
    assert at_pointer(document, "/a/0/b~1c") == 1
    assert at_pointer(document, "#/a/0/~0") == 2
    assert at_pointer(document, "") is document
    for lost in ("/a/1", "/x", "/a/0/b/c", "/a/-1"):
        assert at_pointer(document, lost) is None


def test_the_id_may_be_in_the_location() -> None:
    assert mesh_of(reply(202, {}, location="http://h/v1/meshes/m%20x"))["id"] == "m x"


def test_checksums_in_etags() -> None:
    digest = "0123456789abcdef" * 4
    for tag in (f'"{digest}"', f'W/"{digest.upper()}"', f'"sha256:{digest}"', f'"{digest}-gzip"'):
        assert sha256_of({"etag": tag}) == digest
    for tag in ('"abc"', f'"{digest}0"', ""):
        assert sha256_of({"etag": tag}) is None


def test_formats_by_suffix() -> None:
    assert format_of("a.xdmf.zip") == format_of("a.ZIP") == "xdmf"
    assert format_of("a.vtu", "npz") == "npz"
    with pytest.raises(BadArgument, match="suffix"):
        format_of("vtu")


def test_quality_speaks_and_lacks_nothing_it_was_not_given() -> None:
    errors = {"l2": 1e-4, "l2_uniform": 2e-3, "h1": 1.0, "h1_uniform": 2.0}
    q_eq = {"max": 1.6375, "rms": 1.0, "cells": [[1, 2]]}
    quality = Quality.from_json({"q_eq": q_eq, "min_jacobian": 0.1, "interpolation_error": errors, "new": 3})
    assert quality.q_eq.max == 1.6375
    assert np.isnan(quality.q_eq.min)
    assert quality.q_eq.cells is not None
    assert quality.q_eq.cells.shape == (1, 2)
    with pytest.raises(AttributeError, match="no measure 'q_foo'"):
        _ = quality.q_foo
    assert "1.6375" in str(quality)
    assert "1.000e-04" in str(quality)
    assert str(Quality.from_json({}))
    assert pickle.loads(pickle.dumps(quality)).min_jacobian == 0.1


def test_convergence_speaks() -> None:
    rows = [
        {"iteration": 0, "max_q_eq": 2.0, "change": None, "error": 0.1, "subdomains": []},
        {"iteration": 1, "max_q_eq": 1.5, "change": 1e-6, "subdomains": [{"newton_steps": 4}, {"newton_steps": 3}]},
    ]
    convergence = Convergence.from_json({"iterations": rows, "rate": 0.25, "predicted_rate": None})
    lines = str(convergence).splitlines()
    assert lines[0].split() == ["iteration", "max_q_eq", "change", "error", "newton", "steps"]
    assert lines[3].split() == ["1", "1.5000", "1.000e-06", "-", "4+3"]
    assert lines[-1] == "observed rate 0.2500"
    assert np.isnan(convergence.column("error")[1])
    swept = [{"sweeps": 2, "status": "converged"}] * 4 + [{"sweeps": 2, "status": "stalled"}]
    rows[0]["transmission"] = "classical"
    rows[1] |= {"transmission": "optimized", "accelerated": True, "work": 7, "subdomains": swept}
    convergence = Convergence.from_json({"iterations": rows})
    said = str(convergence).splitlines()
    assert said[0].split()[-2:] == ["sweeps", "remark"]
    assert said[3].endswith("5 x 2  optimized took over, 1 stalled, accelerated")
    assert convergence.column("work")[1] == 7
    assert str(Convergence.from_json({})) == "one domain: no Schwarz iteration"


def test_tables() -> None:
    assert align(["a", "bb"], [["ccc", "1"]]) == "a    bb\n-------\nccc   1"
    cases = {0.0: "0.0000", 1e-3: "0.0010", 9e-4: "9.000e-04", -2e5: "-2.000e+05", np.inf: "inf", np.nan: "-"}
    assert {value: number(value) for value in cases} == cases


def test_an_empty_id_is_no_mesh() -> None:
    with pytest.raises(BadArgument, match="id of a mesh is empty"):
        get_mesh("")
