"""The table of formats, the format that a name has, and the rows and files of parts."""

from __future__ import annotations

from pathlib import Path

import pytest

import equimesh as em
from equimesh.errors import InputError
from equimesh_cluster.part_files.formats import (
    PARTED_FORMATS,
    PartedGrid,
    part_path,
    part_reference,
    parted_format,
    staged,
)

GRID = em.Grid(n_xi=10, n_eta=5)


def test_every_format_has_a_name_of_its_own() -> None:
    assert [*PARTED_FORMATS] == ["pvtu", "vtkhdf", "zarr"]
    for name, kind in PARTED_FORMATS.items():
        assert kind.name == name
        assert kind.readers
        assert kind.sides
        assert bool(kind.part_suffix) is bool(kind.part_media_type)
        assert parted_format(f"folder/mesh{kind.suffix}") is kind
        assert parted_format(f"mesh{kind.suffix}", name) is kind
    of_parts = [kind.part_suffix for kind in PARTED_FORMATS.values()]
    assert len({*of_parts}) == len(of_parts)  # in one folder


@pytest.mark.parametrize(
    ("path", "name", "reason"),
    [
        ("mesh.vts", None, r"it must end in \.pvtu, \.vtkhdf, \.zarr"),
        ("mesh.pvts", None, r"'mesh\.pvts' cannot be .* it must end in \.pvtu, \.vtkhdf, \.zarr"),
        ("mesh.xdmf", None, r"'mesh\.xdmf' cannot be .* it must end in \.pvtu, \.vtkhdf, \.zarr"),
        (".zarr", None, "it must end in"),
        ("mesh", None, "it must end in"),
        ("mesh.vtkhdf", "pvtu", r"it must end in \.pvtu$"),
        ("mesh.pvtu", "npz", "unknown format 'npz' of parts: choose one of pvtu, vtkhdf, zarr"),
        ("mesh.pvts", "pvts", "unknown format 'pvts' of parts: choose one of pvtu, vtkhdf, zarr"),
        ("mesh.xdmf", "xdmf", "unknown format 'xdmf' of parts: choose one of pvtu, vtkhdf, zarr"),
    ],
)
def test_other_names_are_refused(path: str, name: str | None, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        parted_format(path, name)


def test_rows_of_parts() -> None:
    parted = PartedGrid.of(GRID, [4, 7])
    assert parted.ends == ((0, 4), (4, 7), (7, 10))
    assert [parted.cell_rows(number) for number in range(parted.count)] == [(0, 4), (4, 7), (7, 9)]
    with pytest.raises(InputError, match="must increase"):
        PartedGrid.of(GRID, [4, 4])
    with pytest.raises(InputError, match="within the 10 rows"):
        PartedGrid.of(GRID, [10])


def test_files_of_parts() -> None:
    kind, head = PARTED_FORMATS["pvtu"], Path("a") / "my.mesh.pvtu"
    assert part_path(head, 12, kind) == Path("a") / "my.mesh" / "part-0012.vtu"
    assert part_reference(head, 12, kind) == "my.mesh/part-0012.vtu"
    assert part_path(head, 12345, kind).name == "part-12345.vtu"


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
