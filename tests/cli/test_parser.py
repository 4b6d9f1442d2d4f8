"""Errors of the command's words."""

from __future__ import annotations

import pytest

from equimesh_cli import main
from equimesh_cli.command import GROUPS, build_parser
from equimesh_cli.parser import Parser


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
        (
            ["solve", "x", "--samples", "u.csv"],
            "u is given twice, as 'x' and as --samples u.csv: leave out",
        ),
        (["solve", "-x*y"], "comes last, after --, as in -- '-x*y'; see equimesh solve --help"),
        (["solve", "x", "u.csv", "y"], "unrecognized arguments: u.csv y; put the expression in quotes"),
        (["solve", "x", "--paramter", "c=3"], "--paramter c=3; perhaps --parameter is meant; see"),
        (["solve", "x", "--monitor", "arclength"], "'arclength' is not known; perhaps arc-length is meant"),
        (["solve", "x", "-n", "nine"], "argument -n/--n-xi: 'nine' is not a whole number; see equimesh solve --help"),
        (["solve", "x", "--t", "late"], "argument --t: 'late' is not a number"),
        (
            ["solve", "x", "-o", "no such/mesh.vtu"],
            "there is no such folder; make it first: mkdir -p 'no such'",
        ),
        (["solve", "x", "--plot-kind", "mesh"], "--plot-kind mesh needs a picture: add --plot FILE, or --open"),
        (["solve", "x", "--monitor", "curvature", "--plot", "a.png", "--plot-kind", "convergence"], "--subdomains 2x1"),
        (
            ["check", "tanh(c*x)"],
            "value with --parameter, as in --parameter c=2\n    tanh(c*x)\n         ^",
        ),
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
