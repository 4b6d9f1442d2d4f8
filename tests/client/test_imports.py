"""The client, and the command line's side of it, need the base install only."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

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


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", BLOCKER + code], capture_output=True, text=True, timeout=300)


def test_the_blocker_blocks() -> None:
    assert "blocked: scipy" in run("import scipy").stderr


def test_the_client_makes_a_mesh_with_the_base_install(service: Any) -> None:
    done = run(
        "from equimesh_client import *\n"
        f"with Client({service.url!r}) as client:\n"
        "    mesh = client.generate(lambda x, y: x * y, 5)\n"
        "    print(mesh.points.shape, mesh.quality.q_eq.max)\n"
        "    try:\n"
        "        mesh.to_meshio()\n"
        "    except BadArgument as error:\n"
        "        print(error)\n"
    )
    assert done.stderr == ""
    assert done.stdout == ("(25, 2) 1.5\nto_meshio() needs meshio, which is not installed: pip install meshio\n")


def test_the_command_generates_with_the_base_install(service: Any, tmp_path: Any) -> None:
    arguments = ["generate", "x", "-n", "5", "-o", str(tmp_path / "m.vtu"), "--url", service.url]
    done = run(f"from equimesh_cli import main; sys.exit(main({arguments!r}))")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "m.vtu").exists()


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (["solve", "x"], "solver"),
        *((words, "service") for words in (["serve"], ["serve", "--port", "8000"], ["doctor"], ["demo"])),
    ],
)
def test_what_needs_an_extra_says_which(arguments: list[str], extra: str) -> None:
    done = run(f"from equimesh_cli import main; sys.exit(main({arguments!r}))")
    assert done.returncode == 2
    assert f"pip install 'equimesh[{extra}]'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_service_elsewhere_is_examined_with_the_base_install() -> None:
    done = run("from equimesh_cli import main; sys.exit(main(['doctor', '--url', 'http://127.0.0.1:9']))")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.startswith("failed   ready        http://127.0.0.1:9 does not answer")


def test_only_one_module_of_the_client_knows_httpx() -> None:
    import ast
    from pathlib import Path

    import equimesh_client

    users = set()
    for path in Path(equimesh_client.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            users |= {path.name for name in names if name.split(".")[0] == "httpx"}
    assert users == {"transport.py"}
