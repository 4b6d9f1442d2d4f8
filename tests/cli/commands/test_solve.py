"""`equimesh solve`: a mesh without a service."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_cli import main

CURVED: dict[str, Any] = {
    "kind": "quadrilateral",
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"points": [[0, 1], [0.5, 1.1], [0.75, 1.1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}


def test_solve_writes_the_partial_mesh_too(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    path = tmp_path / "m.npz"
    few = "-n 12 --monitor arc-length --subdomains 2x1 --overlap 2 --transmission classical --max-iterations 2"
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


def test_a_folder_is_an_openfoam_case(tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    assert main(["solve", "x*y", "-n", "5", "--monitor", "arc-length", "--quiet", "-o", str(tmp_path)]) == 0
    assert (tmp_path / "constant" / "polyMesh" / "points").read_text().count("\n(") == 2 * 25 + 1


def test_points_choose_the_cells_of_blocks(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    corners = {"vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]}}
    (tmp_path / "b.json").write_text(json.dumps({**corners, "blocks": [{"corners": list("abcd"), "cells": [8, 8]}]}))
    words = ["tanh(9*y)", "--domain-file", str(tmp_path / "b.json"), "-o", str(tmp_path / "m.npz")]
    assert main(["solve", *words, "--points", "200"]) == 0
    shape = np.load(tmp_path / "m.npz")["blocks/block0"].shape
    assert shape[1] > 2 * shape[0]
    assert f"{shape[0] * shape[1]} points" in capsys.readouterr().out
    assert main(["solve", *words, "--points", "200", "-n", "9"]) == 2
    assert "--points takes the place of -n" in capsys.readouterr().err


def test_solve_writes_what_generate_would(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    mesh, picture = tmp_path / "m.npz", tmp_path / "m.png"
    words = "-n 12 --monitor arc-length --subdomains 2x1 --overlap 2 --transmission linear_robin --p 2.3"
    words += " --compare --plot-kind convergence"
    assert main(["solve", "x*y", *words.split(), "-o", str(mesh), "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "q_eq" in out
    assert "observed rate" in out
    assert np.load(mesh)["x"].shape == (12, 12)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["solve", "x*y", "-n", "8", "--for", "interpolation", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    kinds = [one["kind"] for one in said["certificate"]["comparison"]]
    assert sorted(kinds) == ["arc_length", "curvature", "least_error", "least_error"]


def test_solve_minimises_the_error(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    words = "--monitor least-error --norm h1 --distortion 0.3 --smoothness 0.5 -n 17 --cells triangle --threads 1"
    picture = f"--plot {tmp_path / 'pair.svg'} --plot-kind comparison"
    files = ["-o", str(tmp_path / "m.vtu"), *picture.split()]
    assert main(["solve", "tanh(20*(x-y))", *words.split(), *files]) == 0
    assert "times smaller, with the same 17 × 17 points" in (tmp_path / "pair.svg").read_text()
    out = capsys.readouterr().out
    assert "  status                completed\n" in out
    assert "equation residual" not in out
    assert "interpolation gain" in out


def test_solve_takes_the_grid_of_a_requested_error(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    path = tmp_path / "m.npz"
    words = "--target-error 2e-3 --monitor least-error --threads 1 --json"
    assert main(["solve", "tanh(9*(x-y))", *words.split(), "-o", str(path)]) == 0
    told = json.loads(capsys.readouterr().out)["certificate"]["target"]
    assert told["reached"] <= told["error"] == 2e-3
    assert list(np.load(path)["x"].shape) == told["grid"]
    assert main(["solve", "tanh(9*(x-y))", "--target-error", "1e-12"]) == 2
    assert "the largest allowed grid, 1025 x 1025, would give about" in capsys.readouterr().err


def test_solve_knows_every_monitor_and_domain(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    (tmp_path / "d.json").write_text(json.dumps(CURVED))
    axis = np.linspace(0, 2, 9)
    np.savez(tmp_path / "rho.npz", x=axis, y=axis, values=1.0 + axis[:, None] * axis)
    for words in (
        "x*y --monitor arc-length --domain rectangle:0,2,0,1",
        "tanh(5*x-5*y) --monitor curvature --norm h1 --isotropic --domain annulus:1,2,0,90 --mode tight",
        f"--monitor weight --rho {tmp_path / 'rho.npz'} --domain rectangle:0,2,0,2 --threads 1",
        f"x --monitor tensor --m11 1+x --m12 0 --m22 1 --smoothing 0.1 --domain @{tmp_path / 'd.json'}",
    ):
        assert main(["solve", "-n", "17", "--json", *words.split()]) == 0
        said = json.loads(capsys.readouterr().out)
        assert said["status"] == said["certificate"]["status"] == "converged"
        assert (said["certificate"]["interpolation_gain"] is None) == ("weight" in words)
        assert said["certificate"]["mode"] == ("tight" if "tight" in words else "discretization")
    assert main(["solve", "x*y", "-n", "9", "--monitor", "arc-length"]) == 0
    assert "  status                converged, mode discretization" in capsys.readouterr().out.splitlines()
    (tmp_path / "d.json").write_text(json.dumps({**CURVED, "left": {"x": "0", "y": "foo*t"}}))
    for words, message in (
        ("x --domain annulus:2,1,0,90", "radii"),
        ("1/x --domain rectangle:-1,1,0,1", "    1/x\n"),
        ("--monitor weight --rho -1", "positive"),
        (f"x --domain @{tmp_path / 'd.json'}", "domain.left.y: "),
        (f"--samples {tmp_path / 'rho.npz'} --domain rectangle:0,4,0,1", "cover"),
    ):
        assert main(["solve", "-n", "9", *words.split()]) == 2, words
        assert message in capsys.readouterr().err


def test_solve_refuses_and_fails_with_words(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    assert main(["solve", "x*", "-n", "8"]) == 2
    assert capsys.readouterr().err.endswith("    x*\n      ^\n")
    assert main(["solve", "nofile.json", "-n", "8"]) == 2
    assert "nofile.json is no expression: give samples by --samples FILE" in capsys.readouterr().err
    assert main(["solve", "x", "-n", "3"]) == 2
    assert "at least 4" in capsys.readouterr().err
    assert main(["solve", "x", "-n", "8", "--subdomains", "9x1"]) == 2
    assert capsys.readouterr().err.startswith("equimesh: ")
    assert main(["solve", "x", "-n", "9999999"]) == 2
    assert "GB of memory" in capsys.readouterr().err
    few = "-n 12 --monitor arc-length --subdomains 2x1 --overlap 2 --transmission classical --max-iterations 2"
    assert main(["solve", "x*y", *few.split()]) == 1
    assert "tolerance" in capsys.readouterr().err
    assert main(["solve", "x*y", *few.split(), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert (said["status"], len(said["convergence"]["iterations"])) == ("not_converged", 3)
    (tmp_path / "u.csv").write_text("x,y,u\n0,0,1\n")
    assert main(["solve", "--samples", str(tmp_path / "u.csv")]) == 2
    (tmp_path / "bad.csv").write_text("x,y,u\n0,0,?\n")
    capsys.readouterr()
    assert main(["solve", "--samples", str(tmp_path / "bad.csv")]) == 2
    assert "bad.csv: line 2 of the csv file" in capsys.readouterr().err


def test_solve_asks_which_column_is_u(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    axis = np.linspace(0, 1, 9)
    rows = [f"{x},{y},{x * y},{x + y}" for x in axis for y in axis]
    file = tmp_path / "flow.csv"
    file.write_text("\n".join(["x,y,T,p", *rows]))
    words = f"--samples {file} -n 8 --monitor arc-length --json".split()
    assert main(["solve", *words]) == 2
    assert "choose u from T, p: " in capsys.readouterr().err
    for column in ("T", "p"):
        assert main(["solve", *words, "--column", column]) == 0
    assert main(["solve", *words, "--column", "q"]) == 2
    assert "no column 'q'" in capsys.readouterr().err


def test_open_draws_the_pair_or_what_is_requested(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    seen: list[Path] = []
    monkeypatch.setattr("equimesh_cli.report.open_picture", lambda path: seen.append(path) is None)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["solve", "x*y", "-n", "5", "--monitor", "arc-length", "--open"]) == 0
    said = capsys.readouterr()
    assert said.err == f"opened {seen[0]}\n"
    assert f"wrote {seen[0]}\n" in said.out
    assert (seen[0].name, seen[0].parent.parent) == ("comparison.png", tmp_path)
    own = tmp_path / "own.svg"
    assert main(["solve", "x*y", "-n", "5", "--monitor", "arc-length", "--plot", str(own), "--open", "--quiet"]) == 0
    assert seen[1] == own
    assert seen[0].read_bytes()[1:4] == b"PNG"
    assert own.stat().st_size > 1000
