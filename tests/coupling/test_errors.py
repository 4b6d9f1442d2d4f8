"""One root for the errors of all packages."""

from __future__ import annotations

import pytest

import equimesh
import equimesh_client
from equimesh_coupling import BadValues, CouplingError, EquimeshError, MissingLibrary, OldLibrary


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
