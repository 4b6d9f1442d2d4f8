"""The table of consumers in the docs is that of the stored records, and they are of every consumer."""

from __future__ import annotations

from dataclasses import replace

from solvers import test_consumers, test_system_consumers
from solvers.table import MESHES, PAGE, in_page, stored, table


def test_the_docs_have_the_table_of_the_stored_records() -> None:
    assert in_page(PAGE.read_text()) == table(stored())


def test_every_consumer_has_records_of_all_meshes() -> None:
    names = {*test_consumers.NAMES.values(), *test_system_consumers.NAMES.values(), test_system_consumers.PRESET}
    assert {record.consumer for record in stored()} == names
    for name in names - {"FreeFEM"}:  # it has triangles only
        assert {record.mesh for record in stored() if record.consumer == name} == {*MESHES}
    assert all(record.read and record.tags for record in stored())


def test_errors_and_gaps_are_shown() -> None:
    record = replace(stored()[0], consumer="X", version="1", format="msh", mesh="square quads")
    first = replace(record, error=1.25e-3, uniform_error=None)
    rows = table([first, replace(first, mesh="annulus quads", error=None, tags=False)]).splitlines()
    assert rows[2] == "| X | 1 | `msh` | yes | no | 1.25e-03 |  | read |  |"
