"""One root for the errors of all packages."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import pytest

import equimesh
import equimesh_client
from equimesh_coupling import BadValues, CouplingError, EquimeshError, MissingLibrary, OldLibrary
from equimesh_coupling.errors import library


@pytest.mark.parametrize("error", [CouplingError, MissingLibrary, OldLibrary, BadValues])
def test_both_roots_catch_what_a_coupling_raises(error: type[Exception]) -> None:
    for root in (equimesh.EquimeshError, equimesh_client.EquimeshClientError, EquimeshError):
        with pytest.raises(root):
            raise error("a sentence")


def test_the_errors_are_those_of_python_too() -> None:
    assert issubclass(MissingLibrary, ImportError)
    assert issubclass(OldLibrary, ImportError)
    assert issubclass(BadValues, ValueError)
    assert not issubclass(equimesh.InputError, CouplingError)


# Libraries that are missing, broken or too old.


def test_a_library_is_imported() -> None:
    assert library("numpy", install="pip install numpy", at_least="1.26").__name__ == "numpy"
    assert library("json.decoder", package="no-such-package", install="", at_least="9").__name__ == "json.decoder"


def test_a_library_that_does_not_load_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "needs_gl.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')")
    (tmp_path / "needs_other.py").write_text("import no_such_module")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingLibrary, match=r"needs_gl, which does not load \(libGL.so.1: cannot open"):
        library("needs_gl", install="apt-get install libgl1")
    with pytest.raises(MissingLibrary, match=r"does not load .No module named 'no_such_module'"):
        library("needs_other", install="")


@pytest.mark.parametrize(
    ("version", "is_old"), [("3.3", True), ("3.9.9", True), ("4.0", False), ("4.0.3rc1", False), ("10.1", False)]
)
def test_a_library_that_is_too_old_is_refused(version: str, is_old: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "version", lambda _: version)
    if not is_old:
        library("json", package="fipy", install="", at_least="4.0")
        return
    with pytest.raises(OldLibrary) as caught:
        library("json", package="fipy", install="pip install 'fipy>=4.0'", at_least="4.0")
    sentence = f"this needs fipy 4.0 or later, and {version} is installed: pip install 'fipy>=4.0'"
    assert str(caught.value) == sentence
