"""`equimesh generate` against a service that answers at once."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_cli import main

COMMAND = [sys.executable, "-m", "equimesh_cli"]


def test_generate_writes_files_and_tables(generate: Any, tmp_path: Path) -> None:
    mesh, picture = tmp_path / "mesh.npz", tmp_path / "mesh.png"
    code, out, err = generate("x*y", "-n", "5", "--n-eta", "4", "-o", str(mesh), "--plot", str(picture))
    assert (code, err) == (0, "")
    assert np.load(mesh)["x"].shape == (5, 4)
    assert picture.read_bytes() == b"\x89PNG"
    assert "q_eq     0.5000" in out
    assert out.splitlines()[0] == "5 x 4 points: The mesh satisfies the equations."
    assert f"wrote {mesh}\nwrote {picture}\n" in out


def test_generate_sends_what_was_asked(generate: Any, service: Any) -> None:
    words = "--subdomains 2x3 --overlap 5 --transmission nonlinear_robin --p 1.5 --ordering coloured"
    words += " --line-correction 2 --acceleration anderson --local-solver newton --no-fallback"
    words += " --tolerance none --max-iterations 7 --compare --boundary orthogonal --initial uniform"
    words += " --cells triangle --monitor arc-length -a 0.5 -b 0.1 --label mine --parameter c=2 --t 0.5"
    code, out, _ = generate("c*x", "-n", "33", *words.split())
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
    assert generate("--samples", str(tmp_path / "u.csv"), "--column", "T", "-n", "5", "--quiet") == (0, "", "")
    assert service.seen("POST", "samples")[0].query == {"column": "T"}
    code, _, err = generate("x", "--column", "T")
    assert code == 2
    assert "--column names a column of --samples FILE" in err


def test_a_mesh_in_parts_is_a_head_with_its_parts(generate: Any, service: Any, tmp_path: Path) -> None:
    service.parted = [("m/part-0000.vtu", b"first"), ("m/part-0001.vtu", b"second"), ("m.pvtu", b"head")]
    path = tmp_path / "mesh.pvtu"
    code, out, err = generate("x*y", "-n", "5", "--parts", "2", "--monitor", "curvature", "-o", str(path))
    assert (code, err) == (0, "")
    assert f"wrote {path}\n" in out
    assert json.loads(service.seen("POST", "meshes")[0].body)["parts"] == 2
    assert path.read_bytes() == b"head"
    assert [(tmp_path / "mesh" / f"part-000{k}.vtu").read_bytes() for k in range(2)] == [b"first", b"second"]
    assert generate("x", "-n", "5", "--parts", "auto", "--quiet")[0] == 0
    assert json.loads(service.seen("POST", "meshes")[-1].body)["parts"] == "auto"


def test_a_mesh_that_is_not_kept_is_one_file(generate: Any, service: Any, tmp_path: Path) -> None:
    path = tmp_path / "mesh.npz"
    code, out, err = generate("x*y", "-n", "5", "--no-store", "-o", str(path))
    assert (code, err) == (0, "")
    assert np.load(path)["x"].shape == (5, 5)
    assert "  status                relaxed" in out
    assert out.endswith(f"wrote {path}\n")
    (sent,) = service.seen("POST", "meshes")
    assert sent.query == {"store": "false", "format": "npz"}
    assert json.loads(generate("x", "-n", "5", "--no-store", "--json", "-o", str(tmp_path / "m.vtu"))[1])["certificate"]
    assert service.seen("POST", "meshes")[-1].query["format"] == "vtu"
    generate("x", "-n", "5", "--no-store", "-o", str(tmp_path / "m.xdmf"))
    assert (tmp_path / "m_facets.h5").read_bytes() == b"facets"  # not the zip in which they come
    assert "\n9 x 7 points. " in generate("x", "--points", "64", "--no-store", "-o", str(path))[1]
    second = ("-o", str(tmp_path / "m.vtu"), "--order", "2")
    for wrong in ((), second, ("-o", str(path), "--open"), ("-o", str(path), "--label", "mine")):
        code, _, err = generate("x", "--no-store", *wrong)
        assert code == 2
        assert "--no-store" in err


def test_json_is_one_object(generate: Any) -> None:
    code, out, _ = generate("x", "-n", "5", "--json")
    said = json.loads(out)
    assert code == 0
    assert said["mesh"]["status"] == "succeeded"
    assert said["quality"]["min_jacobian"] == 0.25
    assert said["files"] == []


def test_key_and_reuse(generate: Any, service: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_KEY", "em_1_environment")
    assert generate("x", "-n", "5", "--no-reuse", "--key", "em_2_given")[0] == 0
    assert service.seen("POST", "meshes")[0].query == {"reuse": "false"}
    assert {request.headers["authorization"] for request in service.requests} == {"Bearer em_2_given"}
    assert main(["check", "x", "--url", service.url]) == 0
    assert service.requests[-1].headers["authorization"] == "Bearer em_1_environment"


def test_no_bar_in_a_pipe_and_one_on_a_terminal(service: Any) -> None:
    command = [*COMMAND, "generate", "x", "-n", "5", "--label", "slow", "--url", service.url]
    piped = subprocess.run(command, capture_output=True, timeout=300, check=True)
    assert piped.stderr == b""
    reading, writing = pty.openpty()
    fcntl.ioctl(writing, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=writing, timeout=300, check=True)
    os.close(writing)
    shown = os.read(reading, 65536).decode()
    os.close(reading)
    assert "newton" in shown
    assert "100%" in shown
