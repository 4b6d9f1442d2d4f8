"""Options that do not go together, or have no meaning."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from client.fake_service import parts_of
from equimesh.io.formats import FORMATS
from equimesh_cli.options.mesh import SECOND_ORDER
from equimesh_cli.options.monitors import domain
from equimesh_client import AnnulusSector, Rectangle


def test_files_of_second_order_are_those_that_the_service_writes() -> None:
    assert tuple(form.suffix for form in FORMATS.values() if form.second_order) == SECOND_ORDER


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["x", "--samples", "u.npz"], "u is given twice"),
        ([], "no u is given"),
        (["x", "--overlap", "4", "--p", "1"], "--overlap, --p is for the Schwarz iteration"),
        (["x", "-o", "mesh.doc"], "mesh.doc: the suffix must be one of .vtu"),
        (["x", "-o", "no/where/mesh.vtu"], "no/where: there is no such folder"),
        (["x", "-o", "no-case"], ", or name the folder of an OpenFOAM case, which must exist"),
        (["x", "-o", "mesh.vts", "--cells", "triangle"], "a .vts file holds no triangles"),
        (["x", "-o", "mesh.su2", "--order", "2"], "--order 2 is for a file of .vtu, "),
        (["x", "--plot", "mesh.gif"], "mesh.gif: the suffix"),
        (["--samples", "missing.npz"], "missing.npz: No such file"),
        (["--samples", "u.npz", "--t", "1"], "belong to an expression"),
        (["x", "--line-correction", "0", "--no-fallback"], "--line-correction, --no-fallback is for the Schwarz"),
        (["x", "--subdomains", "2x1", "--transmission", "classical", "--p", "2"], "--p is for --transmission linear"),
        (["x", "--subdomains", "2x1", "--p", "2"], "and this is --transmission optimized"),
        (
            ["x", "--subdomains", "2x1", "--transmission", "classical", "--interface-data", "local"],
            "is for --transmission opt",
        ),
        (["x", "--deadline", "-1"], "deadline = -1"),
        (["--monitor", "weight"], "--monitor weight needs --rho"),
        (["--monitor", "tensor", "--m11", "1"], "--monitor tensor needs --m12, --m22"),
        (
            ["x", "--monitor", "arc-length", "--norm", "h1"],
            "--norm is for --monitor auto or least-error or nodal-solution or curvature, and this is --monitor arc",
        ),
        (["x", "-n", "9", "--target-error", "1e-3"], "--target-error takes the place of -n"),
        (["x", "--target-norm", "h1"], "add --target-error"),
        (["x", "--points", "99", "-n", "9"], "--points takes the place of -n"),
        (["x", "--points", "4"], "--points 4: give at least 25"),
        (["x", "-a", "0.5"], "-a is for --monitor arc-length, and this is --monitor auto"),
        (["x", "--smoothing", "0.1"], "--smoothing is for --monitor arc-length or curvature"),
        (["x", "--distortion", "1"], "--distortion is for --monitor least-error, and this is --monitor auto"),
        (["x", "--monitor", "curvature", "-a", "0.5"], "-a is for --monitor arc-length"),
        (["--monitor", "curvature"], "no u is given"),
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


@pytest.mark.parametrize(("text", "sent"), [("3x2", [3, 2]), ("24,40,x1", [[24, 40], 1]), ("2x24,", [2, [24]])])
def test_subdomains_are_counted_or_meet_at_given_lines(generate: Any, service: Any, text: str, sent: list[Any]) -> None:
    code, _, _ = generate("x", "--monitor", "arc-length", "--subdomains", text)
    assert code == 0
    assert json.loads(service.seen("POST", "meshes")[0].body)["schwarz"]["subdomains"] == sent


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
    assert sent["monitor"] == {"kind": "weight", "rho": {"samples": "upload"}, "u": {"expression": "x"}, "map": "lines"}
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
    for points in (900, 9):  # how few points its blocks can have, the service knows
        assert generate("x", "--quiet", "--domain-file", str(tmp_path / "b.json"), "--points", str(points))[0] == 0
        sent = json.loads(service.seen("POST", "meshes")[-1].body)
        assert ("grid" in sent, sent["target"]["max_points"]) == (False, points)
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
