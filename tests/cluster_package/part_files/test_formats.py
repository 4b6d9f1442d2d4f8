"""The table of formats, the format that a name has, and the rows and files of parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from cluster_package.part_files.parted import CUTS, DATA, parts_of
from equimesh.errors import InputError
from equimesh.io.write import node_groups
from equimesh_cluster import PartData
from equimesh_cluster.part_files.formats import (
    BLOCK_NUMBERS,
    PARTED_FORMATS,
    PartedGrid,
    blocks,
    part_path,
    part_reference,
    parted_format,
    side_digits,
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


# What a part may hold: names, shapes, blocks, and the sides of its nodes.


def test_names_and_shapes_are_checked() -> None:
    part = parts_of(CUTS[1])[0]
    rows, columns = part.x.shape
    for data, reason in (
        (PartData(nodes={"x": part.x}), "there is an array 'x' already"),
        (PartData(nodes={"u": part.x}, cells={"u": part.x[1:, 1:]}), "there is an array 'u' already"),
        (PartData(nodes={"a/b": part.x}), "cannot be the name of an array"),
        (PartData(nodes={"é": part.x}), "cannot be the name of an array"),
        (
            PartData(nodes={"u": part.x[1:]}),
            rf"u has shape \({rows - 1}, {columns}\): part 0 needs \({rows}, {columns}\)",
        ),
        (PartData(cells={"q": part.x}), f"part 0 needs .{rows - 1}, {columns - 1}"),
    ):
        with pytest.raises(InputError, match=reason):
            data.check(part)
    PartData(nodes={"u": part.x}, cells={"q": part.x[1:, 1:]}).check(part)


def test_blocks_cover_everything_once() -> None:
    found = [*blocks(1000, 1025)]
    assert [row for some in found for row in range(some.start, some.stop)] == [*range(1000)]
    assert max(some.stop - some.start for some in found) == BLOCK_NUMBERS // 1025
    assert [*blocks(2, 10 * BLOCK_NUMBERS)] == [slice(0, 1), slice(1, 2)]
    assert [*blocks(0, 5)] == []


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_sides_are_those_of_the_whole_mesh(cuts: tuple[int, ...]) -> None:
    expected = node_groups(DATA).reshape(DATA.mesh.x.shape)
    for part in parts_of(cuts):
        found = side_digits(part, slice(0, part.x.shape[0]))
        np.testing.assert_array_equal(found, expected[part.first : part.first + part.x.shape[0]])
        np.testing.assert_array_equal(side_digits(part, slice(3, 5)), found[3:5])
