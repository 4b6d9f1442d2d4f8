"""Options that do not go together, or have no meaning."""

from __future__ import annotations

import json
from typing import Any

import pytest

from equimesh.io.formats import FORMATS
from equimesh_cli.options.mesh import SECOND_ORDER


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
        (
            ["x", "--subdomains", "2x1", "--transmission", "classical", "--p", "2"],
            "--p is for --transmission linear",
        ),
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
