"""One list of cases for the clients of all languages: each finds the meshes and the sentences that Python's finds."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from equimesh_client import Client, EquimeshClientError, RetryPolicy

ROOT = Path(__file__).parents[2]
DRIVERS = ROOT / "tests" / "languages"
NOWHERE = "http://127.0.0.1:9"
FRONT = {"monitor": {"kind": "arc_length", "u": {"expression": "tanh(9*(x - y))"}}, "grid": {"n_xi": 9, "n_eta": 7}}
BEND = {
    "kind": "blocks",
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [2, 0], "d": [0, 1], "e": [1, 1], "f": [2, 1]},
    "blocks": [
        {"corners": ["a", "b", "e", "d"], "cells": [4, 4]},
        {"corners": ["b", "c", "f", "e"], "cells": [4, None]},
    ],
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """What a client is to do with a spec: ``generate``, a ``round`` after it, or a ``step`` of a sequence.

    ``diverge`` is a round with NaN and infinity at the second and third node.
    """

    action: str
    spec: dict[str, Any]
    url: str = ""
    """Another address than that of the service."""
    refused: bool = False


CASES = {
    "a grid": Case(action="generate", spec=FRONT),
    "triangles": Case(action="generate", spec={**FRONT, "cells": "triangle"}),
    "blocks": Case(action="generate", spec={"monitor": {"kind": "least_error", "u": "x*x*y"}, "domain": BEND}),
    "a round": Case(action="round", spec=FRONT),
    "a round on blocks": Case(action="round", spec={"monitor": {"kind": "least_error", "u": "x*x*y"}, "domain": BEND}),
    "a step": Case(action="step", spec=FRONT),
    "a step on blocks": Case(action="step", spec={"monitor": {"kind": "least_error", "u": "x*x*y"}, "domain": BEND}),
    "a mesh that takes longer": Case(action="generate", spec=FRONT, url="slow"),
    "a name that is not known": Case(action="generate", spec={"monitor": {"u": {"expression": "x+é"}}}, refused=True),
    "a solver that diverged": Case(action="diverge", spec=FRONT, refused=True),
    "a grid that is too small": Case(action="step", spec={**FRONT, "grid": {"n_xi": 2, "n_eta": 7}}, refused=True),
    "a service that is not there": Case(action="generate", spec=FRONT, url=NOWHERE, refused=True),
}


def weighed(values: Any) -> float:
    """A sum that changes with each value and with their order."""
    flat = np.ravel(values)
    return float(np.arange(1, flat.size + 1) @ flat)


def by_python(case: Case, url: str) -> str:
    """What Python's client has for a case: numbers, or a sentence."""
    spec = {**case.spec}
    with Client(case.url or url, retries=RetryPolicy(retries=0)) as client:
        try:
            if case.action == "step":
                monitor, domain = spec["monitor"], spec.get("domain")
                more = {} if domain is None else {"domain": domain}
                n = () if "grid" not in spec else ((spec["grid"]["n_xi"], spec["grid"]["n_eta"]),)
                sequence = client.sequences.start(None, *n, monitor=monitor, **more)
                at = sequence.current.arrays
                step = sequence.step(at.x * at.x * at.x + at.y, {"T": at.x + 2 * at.y})
                sequence.delete()
                return numbers_of(step.arrays, step.arrays.fields["T"])
            mesh = client.meshes.create(spec, wait=300).wait(progress=False).arrays()
            if case.action != "generate":
                x, y = mesh.x, mesh.y
                u = x * x * x + y
                if case.action == "diverge":
                    u[0, 1:3] = np.nan, -np.inf
                nodal = {"x": x.tolist(), "y": y.tolist(), "values": u.tolist()}
                of_blocks = {"nodes": mesh.points.tolist(), "values": u.tolist()}
                source = {"nodal": nodal} if x.ndim == 2 else {"block_nodes": of_blocks}
                spec["monitor"] = {"kind": "nodal_solution", "u": source}
                mesh = client.meshes.create(spec, wait=300).wait(progress=False).arrays()
            return numbers_of(mesh)
        except EquimeshClientError as error:
            return str(error)


def numbers_of(mesh: Any, *fields: Any) -> str:
    values = [len(mesh.points), *mesh.cells.shape, *map(weighed, (mesh.x, mesh.y, mesh.cells, *fields))]
    return " ".join(map(repr, values))


def repacked(npz: bytes) -> bytes:
    """The same arrays in a file of ``numpy.savez``."""
    file = io.BytesIO()
    np.savez(file, **np.load(io.BytesIO(npz)))
    return file.getvalue()


@pytest.fixture(scope="module")
def slow(url: str) -> Iterator[str]:
    """A service that answers each request with 202 first, and with the answer of the real one to the second.

    The file is packed as the service packs one of a large mesh, with fields of 64 bits in the zip.
    """
    keys: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            keys.append(self.headers["Idempotency-Key"])
            sent = {"Content-Type": "application/json", "Prefer": "wait=300"}
            answer = (
                httpx.post(url + self.path, content=body, headers=sent, timeout=600.0) if len(keys) % 2 == 0 else None
            )
            if answer is not None:
                assert keys[-1] == keys[-2]
            self.send_response(202 if answer is None else 201)
            content = b"{}" if answer is None else repacked(answer.content)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(scope="module")
def expected(url: str) -> dict[str, str]:
    """What Python's client has for each case."""
    return {name: by_python(case if case.url != "slow" else Case(action="generate", spec=FRONT), url)
            for name, case in CASES.items()}  # fmt: skip


@pytest.fixture(scope="module")
def listed(url: str, slow: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cases as a file, a line each."""
    file = tmp_path_factory.mktemp("languages") / "cases.tsv"
    rows = [
        "\t".join([name, {"slow": slow, "": url}.get(case.url, case.url), case.action, json.dumps(case.spec)])
        for name, case in CASES.items()
    ]
    file.write_text("\n".join(rows) + "\n")
    return file


def run(*command: str | Path, **environment: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env={**os.environ, **environment})
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def check(said: str, expected: dict[str, str], url: str) -> None:
    """Every case has the numbers, or the sentence, that it has in Python."""
    found = dict(line.split("\t", 1) for line in said.strip().splitlines())
    assert [*found] == [*CASES]
    for name, case in CASES.items():
        if not case.refused:
            numbers = [[float(word) for word in text.split()] for text in (found[name], expected[name])]
            assert numbers[0] == pytest.approx(numbers[1], rel=1e-12), name
        elif case.url:
            assert case.url in found[name]
            assert "does not answer" in found[name]
            assert "equimesh serve" in found[name]
        elif case.action == "diverge":
            assert found[name] == "/monitor/u/nodal/values/0/1: this must be a finite number, not NaN or infinity"
        else:
            path = "/v1/sequences" if case.action == "step" else "/v1/meshes"
            problem = httpx.post(url + path, json=case.spec).json()
            assert found[name] == problem["detail"]
            assert problem["errors"][0]["message"] in expected[name]


def test_the_cases_tell_meshes_apart(expected: dict[str, str]) -> None:
    told = [expected[name] for name, case in CASES.items() if not case.url]
    assert len({*told}) == len(told)
    assert NOWHERE in expected["a service that is not there"]


@pytest.mark.needs("cc")
def test_c_finds_the_same(expected: dict[str, str], listed: Path, url: str, tmp_path: Path) -> None:
    client = ROOT / "client" / "c"
    strict = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsanitize=address,undefined", "-g"]
    sources = [client / "equimesh.c", DRIVERS / "conformance.c"]
    run("cc", *strict, f"-I{client}", *sources, "-lcurl", "-o", tmp_path / "run")
    check(run(tmp_path / "run", listed), expected, url)


@pytest.mark.needs("cc")
def test_c_reads_nothing_beyond_what_was_sent(tmp_path: Path) -> None:
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", "-g"]
    run("cc", *strict, f"-I{ROOT / 'client' / 'c'}", DRIVERS / "broken.c", "-lcurl", "-o", tmp_path / "run")
    whole = {"x": np.zeros((2, 2)), "y": np.zeros((2, 2)), "u": np.zeros((2, 2)), "cells": np.array([[0, 2, 3, 1]])}
    wrong: list[dict[str, Any]] = [{"u": np.zeros(3)}, {"y": np.zeros((2, 2), dtype=int)}, {"cells": np.arange(4)}]
    for arrays in ({}, *wrong):
        np.savez(tmp_path / "mesh.npz", **whole | arrays)
        said = run(tmp_path / "run", tmp_path / "mesh.npz")
        assert ("cannot be read" in said) == bool(arrays), arrays


@pytest.mark.needs("cc", "gfortran")
def test_fortran_finds_the_same(expected: dict[str, str], listed: Path, url: str, tmp_path: Path) -> None:
    run("cc", "-c", ROOT / "client" / "c" / "equimesh.c", "-o", tmp_path / "equimesh.o")
    sources = [ROOT / "client" / "fortran" / "equimesh.f90", DRIVERS / "conformance.f90"]
    strict = ["-std=f2008", "-Wall", "-Werror", "-fcheck=all", f"-J{tmp_path}"]
    run("gfortran", *strict, *sources, tmp_path / "equimesh.o", "-lcurl", "-o", tmp_path / "run")
    check(run(tmp_path / "run", listed), expected, url)


@pytest.mark.needs("octave", "curl")
def test_octave_finds_the_same(expected: dict[str, str], listed: Path, url: str) -> None:
    command = ["octave-cli", "--norc", "--quiet", "--path", ROOT / "client" / "octave", DRIVERS / "conformance.m"]
    check(run(*command, CASES=str(listed)), expected, url)


@pytest.mark.needs("julia")
def test_julia_finds_the_same(expected: dict[str, str], listed: Path, url: str) -> None:
    client = ROOT / "client" / "julia" / "Equimesh.jl"
    check(run("julia", "--startup-file=no", DRIVERS / "conformance.jl", client, listed), expected, url)


def only_octave_has(code: str) -> list[str]:
    """What MATLAB does not take of a text for Octave, without what stands in quotes or comments."""
    plain = re.sub(r"(?<![\w)\]}.'])'(?:[^'\n]|'')*'", "''", code)
    plain = re.sub(r"%.*", "", plain)
    words = r"\b(?:end[a-z_]+|until|do|unwind_protect|printf|puts|columns|ifelse)\b"
    return re.findall(words + r"|[#\"!]|\+\+|--|[-+*/^|&]=|\*\*|\)[({]", plain)


def test_matlab_takes_the_file_for_octave() -> None:
    assert only_octave_has((ROOT / "client" / "octave" / "equimesh.m").read_text()) == []
    for code in ("endif", "x += 1", 'y = "a"', "z = f(1)(2)", "# note", "!x", "printf ('a')", "a = size (x)(1)", "n++"):
        assert only_octave_has(f"{code}\nb = x.' % 'don''t'\n"), code


@pytest.mark.needs("octave")
def test_octave_gives_no_command_of_a_service_to_the_shell(tmp_path: Path) -> None:
    address = f'/v1/";touch {tmp_path / "made"};"'
    sequence = f"struct ('url', '{NOWHERE}', 'address', '{address}')"
    words = f"try, equimesh ('end', {sequence}); catch fault, disp (fault.identifier); end"
    said = run("octave-cli", "--norc", "--quiet", "--path", ROOT / "client" / "octave", "--eval", words)
    assert (said.strip(), [*tmp_path.iterdir()]) == ("equimesh:input", [])
