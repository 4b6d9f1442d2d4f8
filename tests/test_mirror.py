"""Where the tests of a package are: ``tests/<part>/<package>/`` for each folder of modules of that part."""

from __future__ import annotations

import ast
import re
from pathlib import Path

TESTS = Path(__file__).parent
ROOT = TESTS.parent
PARTS = {
    "solver": ROOT / "solver" / "equimesh",
    "service": ROOT / "service" / "equimesh_service",
    "client": ROOT / "client" / "equimesh_client",
    "coupling": ROOT / "client" / "equimesh_coupling",
    "schema": ROOT / "client" / "equimesh_schema",
    "cli": ROOT / "client" / "equimesh_cli",
}
# Modules of the solver that the tests of their folder do not name, with the reason.
UNNAMED = {
    "schwarz/holding/port.py": "an interface; test_in_one_process.py and test_on_channel.py test both implementations",
}


def test_every_folder_of_tests_stands_where_its_package_stands() -> None:
    for part, package in PARTS.items():
        for file in (TESTS / part).rglob("test_*.py"):
            folder = package / file.parent.relative_to(TESTS / part)
            assert folder.is_dir(), f"{file} has no package {folder}"


def test_every_module_of_the_solver_has_tests_in_the_folder_of_its_package() -> None:
    package = PARTS["solver"]
    modules = [path for path in package.rglob("*.py") if path.name != "__init__.py"]
    unnamed = {path.relative_to(package).as_posix() for path in modules if not _is_named(path)}
    assert unnamed <= {*UNNAMED}


def _is_named(module: Path) -> bool:
    """Whether a file of tests in the folder of a module, or a word in one, names it or something that it defines."""
    folder = TESTS / "solver" / module.parent.relative_to(PARTS["solver"])
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
