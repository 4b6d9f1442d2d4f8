"""Where the test of a module is: ``tests/<part>/<package>/test_<noun>.py`` for ``<package>/<noun>.py`` of that part."""

from __future__ import annotations

from pathlib import Path

import pytest

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
# Tests of no single module, by part, with the reason.
OF_NO_MODULE: dict[str, dict[str, str]] = {
    "solver": {},
    "service": {
        "assembly/test_schwarz.py": "the half of problem.py that builds the settings of the Schwarz iteration",
        "spec/test_sources.py": "what the service answers about functions, which equimesh_schema describes",
    },
    "client": {"test_imports.py": "what the whole package imports"},
    "coupling": {},
    "schema": {},
    "cli": {},
}
# Modules of the solver without a file of tests, with the reason.
WITHOUT_TESTS = {
    "cluster/errors.py": "names of errors, which the other tests of the folder see raised",
    "numerics/types.py": "names of types",
    "single_domain/steps.py": "records; test_level.py and test_iteration.py look at what they hold",
    "testing/functions.py": "what the kits are run on",
    "solving/options.py": "a record; test_inputs.py looks at the words",
    "schwarz/holding/port.py": "an interface; test_in_one_process.py and test_on_channel.py test both implementations",
}


def modules(part: str) -> set[str]:
    """The modules of a part, as paths below its package."""
    found = (path.relative_to(PARTS[part]).as_posix() for path in PARTS[part].rglob("*.py"))
    return {name for name in found if not name.endswith("__init__.py")}


@pytest.mark.parametrize("part", PARTS)
def test_every_file_of_tests_stands_where_its_module_stands(part: str) -> None:
    files = {path.relative_to(TESTS / part).as_posix() for path in (TESTS / part).rglob("test_*.py")}
    tested = {name for name in files if name.replace("test_", "", 1) in modules(part)}
    assert files - tested == {*OF_NO_MODULE[part]}


def test_every_module_of_the_solver_has_its_tests() -> None:
    files = {path.relative_to(TESTS / "solver").as_posix() for path in (TESTS / "solver").rglob("test_*.py")}
    untested = {
        name for name in modules("solver") if Path(name).with_name(f"test_{Path(name).name}").as_posix() not in files
    }
    assert untested <= {*WITHOUT_TESTS} <= modules("solver")
