"""Where the tests of a package are: ``tests/<part>/<package>/`` for each folder of modules of that part."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
PARTS = {
    "solver": ROOT / "solver" / "equimesh",
    "cluster_package": ROOT / "solver" / "equimesh_cluster",
    "service": ROOT / "service" / "equimesh_service",
    "client": ROOT / "client" / "equimesh_client",
    "coupling": ROOT / "client" / "equimesh_coupling",
    "schema": ROOT / "client" / "equimesh_schema",
    "cli": ROOT / "client" / "equimesh_cli",
}
# Parts whose modules are all named by the tests of their folder, but for these, with the reason.
UNNAMED: dict[str, dict[str, str]] = {"cluster_package": {}, "solver": {}}


def test_every_folder_of_tests_stands_where_its_package_stands() -> None:
    for part, package in PARTS.items():
        for file in (TESTS / part).rglob("test_*.py"):
            folder = package / file.parent.relative_to(TESTS / part)
            assert folder.is_dir(), f"{file} has no package {folder}"


@pytest.mark.parametrize("part", UNNAMED)
def test_every_module_has_tests_in_the_folder_of_its_package(part: str) -> None:
    package = PARTS[part]
    modules = [path for path in package.rglob("*.py") if path.name != "__init__.py"]
    unnamed = {path.relative_to(package).as_posix() for path in modules if not _is_named(part, path)}
    assert unnamed <= {*UNNAMED[part]}


def _is_named(part: str, module: Path) -> bool:
    """Whether a file of tests in the folder of a module, or a word in one, names it or something that it defines."""
    folder = TESTS / part / module.parent.relative_to(PARTS[part])
    if (folder / f"test_{module.name}").exists():
        return True
    words = {word for file in folder.glob("*.py") for word in re.findall(r"\w+", file.read_text())}
    return not words.isdisjoint({module.stem, *_defined(module)})


def _defined(module: Path) -> set[str]:
    """The functions, classes and constants of a module, without those that begin with ``_``."""
    names = set[str]()
    for node in ast.parse(module.read_text()).body:
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
                names.add(name)
            case ast.Assign(targets=[ast.Name(id=name)]):
                names.add(name)
    return {name for name in names if not name.startswith("_")}
