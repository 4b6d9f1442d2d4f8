"""Rows and files of parts."""

from __future__ import annotations

from pathlib import Path

import pytest

import equimesh as em
from equimesh.errors import InputError
from equimesh.io import PARTED_FORMATS
from equimesh.io.by_parts.layout import PartedGrid, part_path, part_reference, staged

GRID = em.Grid(n_xi=10, n_eta=5)


def test_rows_of_parts() -> None:
    parted = PartedGrid.of(GRID, [4, 7])
    assert parted.ends == ((0, 4), (4, 7), (7, 10))
    assert [parted.cell_rows(number) for number in range(parted.count)] == [(0, 4), (4, 7), (7, 9)]
    with pytest.raises(InputError, match="must increase"):
        PartedGrid.of(GRID, [4, 4])
    with pytest.raises(InputError, match="within the 10 rows"):
        PartedGrid.of(GRID, [10])


def test_files_of_parts() -> None:
    kind, head = PARTED_FORMATS["pvts"], Path("a") / "my.mesh.pvts"
    assert part_path(head, 12, kind) == Path("a") / "my.mesh" / "part-0012.vts"
    assert part_reference(head, 12, kind) == "my.mesh/part-0012.vts"
    assert part_path(head, 12345, kind).name == "part-12345.vts"


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(FileNotFoundError), staged(path) as unfinished:
        unfinished.write_text((tmp_path / "none").read_text())
    assert path.read_text() == "old"
    with staged(path) as unfinished:
        unfinished.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert [*tmp_path.iterdir()] == [path]
