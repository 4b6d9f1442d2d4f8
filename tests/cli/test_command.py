"""The command line: codes, words, files."""

from __future__ import annotations

import fcntl
import importlib.metadata
import json
import math
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from client.fake_service import parts_of
from equimesh_cli import main
from equimesh_cli.command import build_parser
from equimesh_client import Certificate

CURVED: dict[str, Any] = {
    "kind": "quadrilateral",
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"points": [[0, 1], [0.5, 1.1], [0.75, 1.1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}
COMMAND = [sys.executable, "-m", "equimesh_cli"]


@pytest.fixture
def generate(service: Any, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs `equimesh generate` against the fake service; gives code, output and errors."""

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main(["generate", *arguments, "--url", service.url])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


@pytest.mark.parametrize(
    "command", ["", "demo", "serve", "config", "doctor", "keys", "database", "generate", "solve", "check"]
)
def test_help_has_examples_and_exit_codes(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([*command.split(), "--help"])
    assert caught.value.code == 0
    said = capsys.readouterr().out
    assert f"examples:\n  equimesh {command or 'demo'}" in said
    assert "130  interrupted" in said


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"equimesh {importlib.metadata.version('equimesh')}\n"


def test_generate_writes_files_and_tables(generate: Any, tmp_path: Path) -> None:
    mesh, picture = tmp_path / "mesh.npz", tmp_path / "mesh.png"
    code, out, err = generate("x*y", "-n", "5", "--n-eta", "4", "-o", str(mesh), "--plot", str(picture))
    assert (code, err) == (0, "")
    assert np.load(mesh)["x"].shape == (5, 4)
    assert picture.read_bytes() == b"\x89PNG"
    assert "q_eq     0.5000" in out
    assert out.splitlines()[1] == "5 x 4 points: The mesh satisfies the equations."
    assert f"wrote {mesh}\nwrote {picture}\n" in out


def test_generate_sends_what_was_asked(generate: Any, service: Any) -> None:
    asked = "--subdomains 2x3 --overlap 5 --transmission nonlinear_robin --p 1.5 --ordering coloured"
    asked += " --line-correction 2 --acceleration anderson --local-solver newton --no-fallback"
    asked += " --tolerance none --max-iterations 7 --compare --boundary orthogonal --initial uniform"
    asked += " --cells triangle -a 0.5 -b 0.1 --label mine --parameter c=2 --t 0.5"
    code, out, _ = generate("c*x", "-n", "33", *asked.split())
    assert code == 0
    assert "iteration  max_q_eq" in out
    assert json.loads(service.seen("POST", "meshes")[0].body) == {
        "monitor": {
            "kind": "arc_length",
            "u": {"expression": "c*x", "parameters": {"c": 2.0}, "t": 0.5},
            "a": 0.5,
            "b": 0.1,
        },
        "grid": {"n_xi": 33, "n_eta": 33},
        "boundary": "orthogonal",
        "initial": "uniform",
        "schwarz": {
            "subdomains": [2, 3],
            "overlap": 5,
            "transmission": {"kind": "nonlinear_robin", "p": 1.5},
            "ordering": "coloured",
            "line_correction": 2,
            "acceleration": "anderson",
            "local_solver": "newton",
            "fallback": False,
            "tolerance": None,
            "max_iterations": 7,
            "compare_single_domain": True,
        },
        "cells": "triangle",
        "label": "mine",
    }


def test_generate_sends_monitor_domain_and_mode(generate: Any, service: Any, tmp_path: Path) -> None:
    asked = "-n 9 --monitor tensor --m11 1+c --m12 0 --m22 2 --smoothing 0.1 --parameter c=2 --quiet"
    assert generate(*asked.split(), "--domain", "annulus:1,3,-30,45", "--mode", "tight", "--no-relax")[0] == 0
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["monitor"] == {
        "kind": "tensor",
        "m11": {"expression": "1+c", "parameters": {"c": 2.0}},
        "m12": {"expression": "0", "parameters": {"c": 2.0}},
        "m22": {"expression": "2", "parameters": {"c": 2.0}},
        "smoothing": 0.1,
    }
    assert sent["domain"] == {"kind": "annulus_sector", "center": [0, 0], "radii": [1, 3], "angles": [-30, 45]}
    assert (sent["mode"], sent["allow_relaxed"]) == ("tight", False)
    assert (
        generate("x", "--monitor", "curvature", "--norm", "h1", "--isotropic", "--domain", "rectangle:0,2,0,1")[0] == 0
    )
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["monitor"] == {"kind": "curvature", "u": {"expression": "x"}, "norm": "h1", "isotropic": True}
    assert sent["domain"] == {"kind": "rectangle", "x": [0, 2], "y": [0, 1]}
    (tmp_path / "rho.csv").write_text("x,y,u\n")
    (tmp_path / "d.json").write_text(json.dumps(CURVED))
    words = ("--monitor", "weight", "--rho", str(tmp_path / "rho.csv"), "--domain", f"@{tmp_path / 'd.json'}")
    assert generate("x", *words)[0] == 0
    sent = json.loads(parts_of(service.seen("POST", "meshes")[-1])["spec"][1])
    assert sent["monitor"] == {"kind": "weight", "rho": {"samples": "upload"}, "u": {"expression": "x"}}
    assert sent["domain"] == CURVED


def test_generate_prints_the_certificate(generate: Any) -> None:
    code, out, _ = generate("x", "-n", "5", "--label", "relaxed")
    assert code == 0
    for words in ("certificate: relaxed", "0.7 requested, 0.35 reached", "warning: The mesh adapts less than asked."):
        assert words in out


def test_the_partial_mesh_of_a_failed_one(generate: Any, service: Any, tmp_path: Path) -> None:
    path = tmp_path / "mesh.npz"
    code, out, err = generate("x", "-n", "5", "--label", "fail", "--partial", "-o", str(path))
    assert (code, out) == (1, f"wrote {path}, a partial mesh\n")
    assert "folded" in err
    assert service.seen("GET", "file")[0].query["partial"] == "true"
    path.unlink()
    assert generate("x", "-n", "5", "--label", "fail", "-o", str(path))[:2] == (1, "")
    assert not path.exists()


def test_generate_uploads_a_file(generate: Any, service: Any, tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("x,y,u\n")
    assert generate("--samples", str(tmp_path / "u.csv"), "-n", "5", "--quiet") == (0, "", "")
    assert b'filename="u.csv"' in service.seen("POST", "meshes")[0].body


def test_json_is_one_object(generate: Any) -> None:
    code, out, _ = generate("x", "-n", "5", "--json")
    said = json.loads(out)
    assert code == 0
    assert said["mesh"]["status"] == "succeeded"
    assert said["quality"]["min_jacobian"] == 0.25
    assert said["files"] == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["x", "--samples", "u.npz"], "either an expression U or --samples"),
        ([], "either an expression U or --samples"),
        (["x", "--overlap", "4", "--p", "1"], "--overlap, --p is for the Schwarz iteration"),
        (["x", "-o", "mesh.doc"], "mesh.doc: the suffix must be one of .vtu"),
        (["x", "-o", "no/where/mesh.vtu"], "no/where: there is no such folder"),
        (["x", "--plot", "mesh.gif"], "mesh.gif: the suffix"),
        (["--samples", "missing.npz"], "missing.npz: No such file"),
        (["--samples", "u.npz", "--t", "1"], "belong to an expression"),
        (["x", "--line-correction", "0", "--no-fallback"], "--line-correction, --no-fallback is for the Schwarz"),
        (["x", "--subdomains", "2x1", "--transmission", "classical", "--p", "2"], "takes no parameter p"),
        (["x", "--subdomains", "2x1", "--p", "2"], "optimized transmission takes no parameter p"),
        (["x", "--subdomains", "2x1", "--transmission", "classical", "--interface-data", "local"], "no interface data"),
        (["x", "--deadline", "-1"], "deadline = -1"),
        (["--monitor", "weight"], "--monitor weight needs --rho"),
        (["--monitor", "tensor", "--m11", "1"], "--monitor tensor needs --m12, --m22"),
        (["x", "--norm", "h1"], "--norm is for --monitor curvature, and this is --monitor arc-length"),
        (["x", "--monitor", "curvature", "-a", "0.5"], "-a is for --monitor arc-length"),
        (["--monitor", "curvature"], "either an expression U or --samples"),
        (["--monitor", "weight", "--rho", "r.npz", "--t", "1"], "belong to an expression"),
        (["--monitor", "weight", "--rho", "missing.npz"], "missing.npz: No such file"),
    ],
)
def test_usage_is_refused_before_anything_is_sent(
    generate: Any, service: Any, arguments: list[str], words: str
) -> None:
    code, out, err = generate(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("equimesh: ")
    assert words in err
    assert service.requests == []


@pytest.mark.parametrize(
    "arguments",
    [
        *(["x", "--subdomains", "2"], ["x", "--p", "much"], ["x", "--parameter", "c"], ["x", "-n", "a"], ["-x"]),
        *(
            ["x", "--domain", text]
            for text in ("disk", "rectangle:0,1", "annulus:1,2,a,b", "@missing.json", "rectangle")
        ),
    ],
)
def test_usage_that_argparse_refuses(generate: Any, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        generate(*arguments)
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("equimesh: ")
    assert said.endswith("; see equimesh generate --help\n")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "the following arguments are required: COMMAND; see equimesh --help"),
        ("serve --prt 3", "unrecognized arguments: --prt 3; see equimesh serve --help"),
        ("keys list x", "unrecognized arguments: x; see equimesh keys list --help"),
    ],
)
def test_the_command_that_knows_its_options_refuses_others(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    assert (caught.value.code, capsys.readouterr().err) == (2, f"equimesh: {said}\n")


def test_bad_input_is_a_sentence_with_a_caret(generate: Any) -> None:
    code, out, err = generate("1+foo", "-n", "5")
    assert (code, out) == (2, "")
    assert err.endswith("      1+foo\n        ^\n")
    assert "Traceback" not in err


def test_a_failed_mesh_is_1(generate: Any) -> None:
    code, _, err = generate("x", "-n", "5", "--label", "fail")
    assert code == 1
    assert err == "equimesh: mesh m0 failed: The mesh folded. At cell 3. Lower a\n"
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


def test_key_and_reuse(generate: Any, service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", "em_1_environment")
    assert generate("x", "-n", "5", "--no-reuse", "--key", "em_2_given")[0] == 0
    assert service.seen("POST", "meshes")[0].query == {"reuse": "false"}
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_2_given"}
    assert main(["check", "x", "--url", service.url]) == 0
    assert service.requests[-1].headers["authorization"] == "Bearer em_1_environment"


def test_check_at_a_service(service: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "x", "--url", service.url]) == 0
    assert capsys.readouterr().out == "ok\n  names: x, y\n"
    assert main(["check", "foo", "--url", service.url]) == 2
    assert capsys.readouterr().err.endswith("      foo\n      ^\n")


def test_check_on_a_domain(service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("scipy")
    monkeypatch.delenv("EQUIMESH_URL", raising=False)
    assert main(["check", "log(x*x+y*y)", "--domain", "annulus:1,2,0,90"]) == 0
    assert main(["check", "log(x)", "--domain", "rectangle:-1,1,0,1"]) == 2
    assert main(["check", "x", "--domain", "rectangle:0,2,0,1", "--url", service.url]) == 0
    assert json.loads(service.seen("POST", "check")[0].body)["domain"]["x"] == [0, 2]


def test_check_here(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("scipy")
    monkeypatch.delenv("EQUIMESH_URL", raising=False)
    assert main(["check", "c*x", "--parameter", "c=2"]) == 0
    assert "u: 0 to 2" in capsys.readouterr().out
    assert main(["check", "1 + foo(x)"]) == 2
    said = capsys.readouterr().err
    assert "foo" in said
    assert said.endswith("    1 + foo(x)\n        ^\n")


def test_the_environment_names_the_service(service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_URL", service.url)
    assert main(["generate", "x", "-n", "5", "--quiet"]) == 0
    assert build_parser().parse_args(["check", "x"]).url == service.url


def test_solve_writes_the_partial_mesh_too(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    path = tmp_path / "m.npz"
    few = "-n 12 --subdomains 2x1 --overlap 2 --transmission classical --max-iterations 2"
    command = ["solve", "x*y", *few.split(), "-o", str(path)]
    assert main(command) == 1
    assert not path.exists()
    capsys.readouterr()
    assert main([*command, "--partial"]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("iteration  max_q_eq")
    assert out.endswith(f"wrote {path}, a partial mesh\n")
    assert "tolerance" in err
    assert np.load(path)["x"].shape == (12, 12)
    assert main([*command, "--partial", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["files"] == [str(path)]


def test_solver_and_client_print_a_certificate_alike() -> None:
    em = pytest.importorskip("equimesh.solving.certificate")
    errors = pytest.importorskip("equimesh.quality.interpolation").InterpolationErrors
    status = pytest.importorskip("equimesh.solving.status").Status
    asked = [("a", 0.7, 0.35), ("points", 129.0, 33.0), ("cross_line", 0.0, 0.03), ("strength", 1.0, 0.123)]
    relaxed = tuple(em.Relaxed(what=what, asked=least, reached=most) for what, least, most in asked)
    gain = errors(l2=1e-3, h1=1e-2, l2_uniform=5.432e-3, h1_uniform=2.0, rounding=(0.0, 0.0))
    bare = {"status": status.CONVERGED, "mode": None, "equation_residual": 0.0, "min_jacobian": 1.0}
    for certificate in (
        em.Certificate(**bare),
        em.Certificate(**bare, algebraic_error=0.0, discretization_error=1.2345e-4, interpolation=gain),
        em.Certificate(**{**bare, "equation_residual": math.inf}, relaxed=relaxed, warnings=("Beware.",)),
    ):
        assert str(certificate) == str(Certificate.from_json(certificate.summary()))
    assert "warning: Beware." in str(certificate)
    assert "equation residual     not known" in str(certificate)
    assert "estimated error       not known\n" in str(certificate)
    for words in (
        "129 requested, 33 reached",
        "cross-line term of weight 0.03 added\n",
        "monitor: 1 requested, 0.12 reached",
    ):
        assert words in str(certificate)
    known = str(em.Certificate(**bare, algebraic_error=0.0, discretization_error=1.2345e-4, interpolation=gain))
    assert "0.00012 of the grid, exact of the solution on it" in known
    assert "5.4 in L2, 200 in H1" in known


def test_solve_writes_what_generate_would(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    mesh, picture = tmp_path / "m.npz", tmp_path / "m.png"
    asked = "-n 12 --subdomains 2x1 --overlap 2 --transmission linear_robin --p 2.3 --compare --plot-kind convergence"
    assert main(["solve", "x*y", *asked.split(), "-o", str(mesh), "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "q_eq" in out
    assert "observed rate" in out
    assert np.load(mesh)["x"].shape == (12, 12)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["solve", "x*y", "-n", "8", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "converged"


def test_solve_knows_every_monitor_and_domain(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    (tmp_path / "d.json").write_text(json.dumps(CURVED))
    axis = np.linspace(0, 2, 9)
    np.savez(tmp_path / "rho.npz", x=axis, y=axis, values=1.0 + axis[:, None] * axis)
    for words in (
        "x*y --domain rectangle:0,2,0,1",
        "tanh(5*x-5*y) --monitor curvature --norm h1 --isotropic --domain annulus:1,2,0,90 --mode tight",
        f"--monitor weight --rho {tmp_path / 'rho.npz'} --domain rectangle:0,2,0,2 --threads 1",
        f"x --monitor tensor --m11 1+x --m12 0 --m22 1 --smoothing 0.1 --domain @{tmp_path / 'd.json'}",
    ):
        assert main(["solve", "-n", "17", "--json", *words.split()]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["status"] == said["certificate"]["status"] == "converged"
        assert (said["certificate"]["interpolation_gain"] is None) == ("weight" in words)
        assert said["certificate"]["mode"] == ("tight" if "tight" in words else "discretization")
    assert main(["solve", "x*y", "-n", "9"]) == 0
    assert capsys.readouterr().out.splitlines()[1] == "certificate: converged, mode discretization"
    (tmp_path / "d.json").write_text(json.dumps({**CURVED, "left": {"x": "0", "y": "foo*t"}}))
    for words, told in (
        ("x --domain annulus:2,1,0,90", "radii"),
        ("1/x --domain rectangle:-1,1,0,1", "    1/x\n"),
        ("--monitor weight --rho -1", "positive"),
        (f"x --domain @{tmp_path / 'd.json'}", "domain.left.y: "),
        (f"--samples {tmp_path / 'rho.npz'} --domain rectangle:0,4,0,1", "cover"),
    ):
        assert main(["solve", "-n", "9", *words.split()]) == 2, words
        assert told in capsys.readouterr().err


def test_solve_says_when_it_has_to_compile(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    said = []
    for _ in range(2):
        command = [*COMMAND, "solve", "x*y", "-n", "9"]
        done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=300, check=True)
        said.append(done.stderr)
    assert said == ["compiling kernels, once per machine ...\n", ""]


def test_solve_refuses_and_fails_with_words(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    assert main(["solve", "x*", "-n", "8"]) == 2
    assert capsys.readouterr().err.endswith("    x*\n      ^\n")
    assert main(["solve", "x", "-n", "3"]) == 2
    assert "at least 4" in capsys.readouterr().err
    assert main(["solve", "x", "-n", "8", "--subdomains", "9x1"]) == 2
    assert capsys.readouterr().err.startswith("equimesh: ")
    assert main(["solve", "x", "-n", "9999999"]) == 2
    assert "GB of memory" in capsys.readouterr().err
    few = "-n 12 --subdomains 2x1 --overlap 2 --transmission classical --max-iterations 2"
    assert main(["solve", "x*y", *few.split()]) == 1
    assert "tolerance" in capsys.readouterr().err
    assert main(["solve", "x*y", *few.split(), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert (said["status"], len(said["convergence"]["iterations"])) == ("not_converged", 3)
    (tmp_path / "u.csv").write_text("x,y,u\n0,0,1\n")
    assert main(["solve", "--samples", str(tmp_path / "u.csv")]) == 2


def test_serve_has_an_option_for_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    settings = pytest.importorskip("equimesh_service.settings").Settings
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    said = capsys.readouterr().out
    for name in settings.model_fields:
        assert f"--{name.replace('_', '-')} " in said
    assert main(["serve", "--port", "many", "--lease", "-1"]) == 2
    said = capsys.readouterr().err
    assert "--port (or EQUIMESH_PORT) = many" in said
    assert "--lease (or EQUIMESH_LEASE) = -1" in said


def test_no_bar_in_a_pipe_and_one_on_a_terminal(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "-n", "5", "--label", "slow", "--url", service.url]
    piped = subprocess.run(command, capture_output=True, timeout=60, check=True)
    assert piped.stderr == b""
    reading, writing = pty.openpty()
    fcntl.ioctl(writing, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=writing, timeout=60, check=True)
    os.close(writing)
    shown = os.read(reading, 65536).decode()
    os.close(reading)
    assert "newton" in shown
    assert "100%" in shown


def test_an_interrupt_is_130_and_cancels(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "--label", "hang", "--url", service.url]
    # Where tests run in the background interrupts are ignored, and what they start would inherit that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    signal.signal(signal.SIGINT, before)
    limit = time.monotonic() + 30
    while not service.seen("GET", "meshes") and time.monotonic() < limit:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (130, b"", b"\nequimesh: interrupted\n")
    assert service.meshes["m0"]["status"] == "canceled"


def test_a_closed_pipe_is_no_error(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "-n", "5", "--json", "--url", service.url]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert (process.wait(timeout=60), err) == (0, b"")
