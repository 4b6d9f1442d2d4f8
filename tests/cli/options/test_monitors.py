"""Options that describe monitors and domains."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from client.fake_service import parts_of
from equimesh_cli.options.monitors import domain
from equimesh_client import AnnulusSector, Rectangle

CURVED: dict[str, Any] = {
    "kind": "quadrilateral",
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"points": [[0, 1], [0.5, 1.1], [0.75, 1.1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}


def test_generate_sends_monitor_domain_and_mode(generate: Any, service: Any, tmp_path: Path) -> None:
    words = "-n 9 --monitor tensor --m11 1+c --m12 0 --m22 2 --smoothing 0.1 --parameter c=2 --quiet"
    assert generate(*words.split(), "--domain", "annulus:1,3,-30,45", "--mode", "tight", "--no-relax")[0] == 0
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["monitor"] == {
        "kind": "tensor",
        "m11": {"expression": "1+c", "parameters": {"c": 2.0}},
        "m12": {"expression": "0", "parameters": {"c": 2.0}},
        "m22": {"expression": "2", "parameters": {"c": 2.0}},
        "smoothing": 0.1,
    }
    shape = {"center": [0, 0], "radii": [1, 3], "angles": [-30, 45], "closed": False}
    assert sent["domain"] == {"kind": "annulus_sector", **shape}
    assert (sent["mode"], sent["allow_relaxed"]) == ("tight", False)
    assert (
        generate("x", "--monitor", "curvature", "--norm", "h1", "--isotropic", "--domain", "rectangle:0,2,0,1")[0] == 0
    )
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["monitor"] == {"kind": "curvature", "u": {"expression": "x"}, "norm": "h1", "isotropic": True}
    assert sent["domain"] == {"kind": "rectangle", "x": [0, 2], "y": [0, 1], "periodic": None}
    words = "--monitor least-error --norm h1 --distortion 0.2 --smoothness 0.3"
    assert generate("x", *words.split())[0] == 0
    assert json.loads(service.seen("POST", "meshes")[-1].body)["monitor"] == {
        "kind": "least_error",
        "u": {"expression": "x"},
        "norm": "h1",
        "distortion": 0.2,
        "smoothness": 0.3,
    }
    assert generate("x", "--target-error", "1e-4", "--target-norm", "h1")[0] == 0
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["target"] == {"norm": "h1", "error": 1e-4, "max_points": None}
    assert generate("x", "--points", "400")[0] == 0
    assert json.loads(service.seen("POST", "meshes")[-1].body)["target"] == {
        "norm": "l2",
        "error": None,
        "max_points": 400,
    }
    assert "grid" not in sent
    assert generate("x", "--norm", "h1")[0] == 0
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["monitor"] == {"kind": "auto", "u": {"expression": "x"}, "norm": "h1"}
    (tmp_path / "rho.csv").write_text("x,y,u\n")
    (tmp_path / "d.json").write_text(json.dumps(CURVED))
    words = ("--monitor", "weight", "--rho", str(tmp_path / "rho.csv"), "--domain", f"@{tmp_path / 'd.json'}")
    assert generate("x", *words)[0] == 0
    sent = json.loads(parts_of(service.seen("POST", "meshes")[-1])["spec"][1])
    assert sent["monitor"] == {
        "kind": "weight",
        "rho": {"samples": "upload"},
        "u": {"expression": "x"},
        "map": "lines",
    }
    assert sent["domain"] == {**CURVED, "closed": False}
    words = ("--monitor", "weight", "--rho", "1 + x", "--map", "gradient")
    assert generate(*words)[0] == 0
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["monitor"] == {"kind": "weight", "rho": {"expression": "1 + x"}, "map": "gradient"}


def test_a_file_is_the_domain(generate: Any, service: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blocks = {"vertices": {"a": [0, 0]}, "blocks": [{"corners": ["a", "a", "a", "a"], "cells": [4, 4]}]}
    (tmp_path / "b.json").write_text(json.dumps(blocks))
    assert generate("x", "--quiet", "--domain-file", str(tmp_path / "b.json"))[0] == 0
    sent = json.loads(service.seen("POST", "meshes")[-1].body)
    assert sent["domain"]["vertices"] == {"a": [0, 0]}
    assert "grid" not in sent
    (tmp_path / "ring.json").write_text(json.dumps({"kind": "annulus_sector"}))
    assert generate("x", "--domain-file", str(tmp_path / "ring.json"), "-n", "9")[0] == 0
    assert json.loads(service.seen("POST", "meshes")[-1].body)["domain"]["kind"] == "annulus_sector"
    (tmp_path / "c.msh").write_bytes(b"mesh")
    assert generate("x", "--quiet", "--domain-file", str(tmp_path / "c.msh"))[0] == 0
    parts = parts_of(service.seen("POST", "meshes")[-1])
    assert json.loads(parts["spec"][1])["domain"]["file"] == "upload"
    assert parts["mesh"][1] == b"mesh"
    assert "leave out -n" in generate("x", "--domain-file", str(tmp_path / "c.msh"), "-n", "9")[2]
    (tmp_path / "b.json").write_text("{}")
    for words, message in (
        (["none.msh"], "there is no such file"),
        (["b.json"], "needs vertices and blocks"),
        (["c.msh", "--domain", "annulus:1,2,0,90"], "not allowed with"),
    ):
        with pytest.raises(SystemExit) as ended:
            generate("x", "--domain-file", str(tmp_path / words[0]), *words[1:])
        assert ended.value.code == 2
        assert message in capsys.readouterr().err


def test_a_fifth_word_closes_lines() -> None:
    assert domain("rectangle:0,2,0,1,both") == Rectangle(x=(0.0, 2.0), periodic="both")
    assert domain("annulus:1,2,0,360,closed") == AnnulusSector(angles=(0.0, 360.0), closed=True)
    for wrong in ("rectangle:0,2,0,1,closed", "annulus:1,2,0,360,x", "rectangle:0,1,x"):
        with pytest.raises(argparse.ArgumentTypeError, match="a fifth word closes lines"):
            domain(wrong)


def test_a_file_in_place_of_a_word_names_its_option(tmp_path: Path) -> None:
    mesh = tmp_path / "plate.msh"
    mesh.write_text("")
    with pytest.raises(argparse.ArgumentTypeError, match=r"plate\.msh is a file: give it as --domain-file"):
        domain(str(mesh))
