"""Errors of the command's words."""

from __future__ import annotations

import json
from typing import Any

import pytest

from equimesh_cli import main
from equimesh_cli.command import GROUPS, build_parser
from equimesh_cli.parser import CommandError, Exit, NotInstalled, Parser, code_of
from equimesh_client import errors


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("serve --prt 3", "unrecognized arguments: --prt 3; perhaps --port is meant; see equimesh serve --help"),
        ("keys list x", "unrecognized arguments: x; see equimesh keys list --help"),
    ],
)
def test_the_command_that_knows_its_options_refuses_others(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    assert (caught.value.code, capsys.readouterr().err) == (2, f"equimesh: {said}\n")


def test_the_help_lists_every_command_once_under_its_group() -> None:
    said = build_parser().format_help()
    for title, names in GROUPS.items():
        section = said.split(f"\n{title}:\n")[1].split("\n\n")[0]
        assert [line.split()[0] for line in section.splitlines()] == list(names)
    below = next(action for action in build_parser()._actions if action.dest == "command")
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(below.choices or ())


def test_paragraphs_are_filled_and_lists_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    parser = Parser(prog="p", description=20 * "word ", epilog="examples:\n  " + 80 * "x" + "\n\n" + 20 * "more ")
    said = parser.format_help().splitlines()
    assert "  " + 80 * "x" in said
    assert sum(line.startswith("word") for line in said) == 2
    assert sum(line.startswith("more") for line in said) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sovle", "x*y"], "argument COMMAND: 'sovle' is no command; perhaps solve is meant; see equimesh --help"),
        (["keys"], "the following arguments are required: {create,list,change,revoke}; see equimesh keys --help"),
        (["solve"], "no u is given: write an expression in quotes, such as 'tanh(20*(x - y))', or --samples FILE"),
        (["solve", "x", "--samples", "u.csv"], "u is given twice, as 'x' and as --samples u.csv: leave out"),
        (["solve", "-x*y"], "comes last, after --, as in -- '-x*y'; see equimesh solve --help"),
        (["solve", "x", "u.csv", "y"], "unrecognized arguments: u.csv y; put the expression in quotes"),
        (["solve", "x", "33"], "unrecognized arguments: 33; the number of points a side is an option: -n 33; see"),
        (["solve", "x", "--paramter", "c=3"], "--paramter c=3; perhaps --parameter is meant; see"),
        (["solve", "x", "--monitor", "arclength"], "'arclength' is not known; perhaps arc-length is meant"),
        (["solve", "x", "-n", "nine"], "argument -n/--n-xi: 'nine' is not a whole number; see equimesh solve --help"),
        (["solve", "x", "-n", "17x9"], "'17x9' is not a whole number: give --n-xi 17 --n-eta 9; see"),
        (["solve", "x", "--mesh", "a.msh"], "--mesh a.msh; perhaps --domain-file is meant"),
        (["solve", "x", "--t", "late"], "argument --t: 'late' is not a number"),
        (["solve", "x", "-o", "no such/mesh.vtu"], "there is no such folder; make it first: mkdir -p 'no such'"),
        (["solve", "x", "--plot-kind", "mesh"], "--plot-kind mesh needs a picture: add --plot FILE, or --open"),
        (["solve", "x", "--monitor", "curvature", "--plot", "a.png", "--plot-kind", "convergence"], "--subdomains 2x1"),
        (["check", "tanh(c*x)"], "value with --parameter, as in --parameter c=2\n    tanh(c*x)\n         ^"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_typical_mistake_is_answered_with_what_to_do(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EQUIMESH_URL", raising=False)
    try:
        code = main(words)
    except SystemExit as end:
        code = int(str(end.code))
    told = capsys.readouterr()
    assert (code, told.out) == (2, "")
    assert said in told.err


def test_a_command_of_an_earlier_release_says_what_took_its_place(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        build_parser().parse_args(["bench", "--quick"])
    assert "'bench' is no command any more; `python benchmarks/bench.py`" in capsys.readouterr().err


# Exit codes, and the sentences of errors.


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
        (CommandError("no"), 2),
        (CommandError("no", Exit.DEADLINE), 4),
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
