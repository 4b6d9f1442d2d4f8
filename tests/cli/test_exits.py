"""Exit codes, and the sentences of errors."""

from __future__ import annotations

import json
from typing import Any

import pytest

from equimesh_cli import main
from equimesh_cli.parser import Exit, NotInstalled, Refused, code_of
from equimesh_client import errors


def test_a_failed_mesh_is_1(generate: Any) -> None:
    code, _, err = generate("x", "-n", "5", "--label", "fail")
    assert code == 1
    assert err == "equimesh: mesh m0 failed: Mesh folded. At cell 3. Lower a\n"
    code, out, _ = generate("x", "-n", "5", "--label", "fail", "--json")
    assert code == 1
    assert json.loads(out)["mesh"]["status"] == "failed"


def test_nobody_there_is_3(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "x", "--url", "http://127.0.0.1:9"]) == 3
    assert "equimesh serve" in capsys.readouterr().err


def test_a_deadline_is_4(generate: Any, service: Any) -> None:
    code, _, err = generate("x", "--label", "hang", "--deadline", "0.4")
    assert code == 4
    assert "deadline of 0.4 s" in err
    assert "more time with --deadline" in err
    assert service.meshes["m0"]["status"] == "canceled"


@pytest.mark.parametrize(
    ("status", "name", "code", "words"),
    [
        (401, "unauthorized", 2, ["--key", "EQUIMESH_KEY"]),
        (403, "forbidden", 2, ["This needs the scope write", "equimesh keys create"]),
        (410, "gone", 2, ["computes it anew"]),
        (429, "quota-exceeded", 3, ["Try again in 90 s", "cancel some"]),
        (429, "queue-full", 3, ["Try again in 90 s", "The remedy."]),
        (507, "storage-full", 3, ["Nothing is wrong with the request"]),
    ],
)
def test_a_problem_is_a_sentence_to_act_on(
    generate: Any, service: Any, fault: Any, status: int, name: str, code: int, words: list[str]
) -> None:
    body = {"type": f"/problems/{name}", "title": "T", "detail": "This needs the scope write.", "remedy": "The remedy."}
    headers = {"Retry-After": "90"} if status == 429 else {}
    service.faults = [fault("POST", "status", status=status, body=body, headers=headers)]
    found, out, err = generate("x", "--key", "em_1_secret")
    assert (found, out) == (code, "")
    assert err.startswith(f"equimesh: T: This needs the scope write (HTTP {status})\n")
    assert all(word in err for word in words), err
    assert "em_1" not in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (Refused("no"), 2),
        (Refused("no", Exit.DEADLINE), 4),
        (NotInstalled("solver", ImportError("x", name="scipy")), 2),
        (FileNotFoundError(2, "No such file", "a"), 2),
        (errors.BadArgument("no"), 2),
        (errors.DeadlineExceeded("late"), 4),
        (errors.ServiceUnreachable("none"), 3),
        (errors.DownloadDamaged("damaged"), 3),
        (errors.ServerError(status=500), 3),
        (errors.RateLimited(status=429), 3),
        (errors.NotFound(status=404), 2),
        (ValueError("a mistake in the program"), None),
        (ConnectionError("not ours"), None),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_error_for_the_user_has_a_code(error: Exception, code: int | None) -> None:
    assert code_of(error) == code
