"""The client, and the command line's side of it, need the base install only."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import equimesh_client

BLOCKED = (
    *("equimesh", "equimesh_service", "scipy", "numba", "h5py", "meshio", "matplotlib", "fastapi", "starlette"),
    *("uvicorn", "pydantic", "pydantic_settings", "sqlalchemy", "multipart", "python_multipart"),
)
BLOCKER = f"""
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {BLOCKED!r}:
            raise ModuleNotFoundError(f"blocked: {{name}}", name=name)
sys.meta_path.insert(0, Blocker())
"""


# Says whether the blocker blocks, makes a mesh, and asks for what is not installed.
CLIENT = """
try:
    import scipy
except ImportError as error:
    print(error)
from equimesh_client import *
with Client(sys.argv[1]) as client:
    mesh = client.generate(lambda x, y: x * y, 5)
    print(mesh.points.shape, mesh.quality.q_eq.max)
    try:
        mesh.to_meshio()
    except BadArgument as error:
        print(error)
"""
# Runs commands, one after the other: the code, the output and the errors of each.
COMMANDS = """
import contextlib, io, json
from equimesh_cli import main
found = []
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as end:
            code = end.code
    found.append([code, out.getvalue(), err.getvalue()])
print(json.dumps(found))
"""


def run(code: str, argument: str) -> str:
    """What a program prints to which only the base install is there."""
    command = [sys.executable, "-c", BLOCKER + code, argument]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_the_client_makes_a_mesh_with_the_base_install(service: Any) -> None:
    assert run(CLIENT, service.url).splitlines() == [
        *("blocked: scipy", "(25, 2) 1.5", "to_meshio() needs meshio, which is not installed: pip install meshio")
    ]


def test_commands_with_the_base_install(service: Any, tmp_path: Path) -> None:
    extras = {("solve", "x"): "solver"}
    extras |= dict.fromkeys([("serve",), ("serve", "--port", "8000"), ("doctor",), ("demo",)], "service")
    path = tmp_path / "m.vtu"
    generate = ["generate", "x", "-n", "5", "-o", str(path), "--url", service.url]
    commands = [generate, ["doctor", "--url", "http://127.0.0.1:9"], *extras]
    (made, _, complaint), (code, report, _), *refused = json.loads(run(COMMANDS, json.dumps(commands)))
    assert (made, complaint, path.exists()) == (0, "", True)
    assert code == 1, "a service elsewhere is examined"
    assert report.startswith("failed   ready        http://127.0.0.1:9 does not answer")
    for (code, _, err), extra in zip(refused, extras.values(), strict=True):
        assert (code, err.count("\n")) == (2, 1)
        assert f"pip install 'equimesh[{extra}]'" in err


def test_only_one_module_of_the_client_knows_httpx() -> None:
    users = set()
    for path in Path(equimesh_client.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            users |= {path.name for name in names if name.split(".")[0] == "httpx"}
    assert users == {"transport.py"}
