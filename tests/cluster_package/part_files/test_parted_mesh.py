"""Parts and heads: names, errors, what is left after a failure, and that only some rows are copied at a time."""

from __future__ import annotations

import socket
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from cluster_package.part_files.parted import ARRAYS, CUTS, DATA, data_of, parts_of, written
from equimesh.errors import InputError
from equimesh_cluster import PARTED_FORMATS, PartData, read_parts, remove_parted, write_head, write_part
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.part_files.parted_mesh import leave_probe, require_probe


@pytest.mark.parametrize("name", [name for name, kind in PARTED_FORMATS.items() if kind.part_suffix])
def test_parts_are_in_a_folder_next_to_the_head_and_can_be_moved_with_it(tmp_path: Path, name: str) -> None:
    kind = PARTED_FORMATS[name]
    head = written(tmp_path, name, CUTS[1])
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert names == {head.name, *(f"mesh/part-000{number}{kind.part_suffix}" for number in range(3))}
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for path in [*tmp_path.glob("mesh*")]:
        path.rename(moved / path.name)
    np.testing.assert_array_equal(read_parts(moved / head.name).rows("u", 0, len(ARRAYS["u"])), ARRAYS["u"])


@pytest.mark.parametrize("name", PARTED_FORMATS)
def test_a_head_without_all_parts_is_refused(tmp_path: Path, name: str) -> None:
    head, cuts = tmp_path / f"mesh{PARTED_FORMATS[name].suffix}", CUTS[1]
    for part in parts_of(cuts)[:2]:
        write_part(head, part, data_of(part))
    with pytest.raises(InputError, match=r"part 2 of 3 .*all workers and the caller reach"):
        write_head(head, grid=DATA.mesh.grid, cuts=cuts, nodes=("u", "v"), cells=("Q_eq",))
    assert not head.exists()


@pytest.mark.parametrize("name", PARTED_FORMATS)
def test_a_part_that_fails_leaves_nothing_and_can_be_written_again(tmp_path: Path, name: str) -> None:
    def failing(*_: np.ndarray) -> np.ndarray:
        raise RuntimeError("no u")

    head, (part,) = tmp_path / f"mesh{PARTED_FORMATS[name].suffix}", parts_of(())
    with pytest.raises(RuntimeError, match="no u"):
        write_part(head, part, PartData(nodes={"u": failing}))
    assert not head.exists()
    if name != "zarr":
        assert [*(tmp_path / "mesh").iterdir()] == []
    write_part(head, part, PartData(nodes={"u": lambda x, y: x * y}))
    write_head(head, grid=part.grid, cuts=(), nodes=("u",))
    np.testing.assert_array_equal(read_parts(head).rows("u", 0, part.grid.n_xi), part.x * part.y)


@pytest.mark.parametrize("name", PARTED_FORMATS)
def test_a_mesh_replaces_an_older_one_of_more_parts(tmp_path: Path, name: str) -> None:
    head = written(tmp_path, name, CUTS[2])
    remove_parted(head)
    assert [*tmp_path.iterdir()] == []
    assert written(tmp_path, name, CUTS[1]) == head
    assert written(tmp_path, name, ()) == head  # over it, without removing it
    mesh = read_parts(head)
    assert mesh.cuts == ()
    np.testing.assert_array_equal(mesh.rows("x", 0, len(ARRAYS["x"])), ARRAYS["x"])


@pytest.mark.parametrize("name", PARTED_FORMATS)
def test_no_array_is_copied_whole(tmp_path: Path, name: str) -> None:
    grid = em.Grid(n_xi=1025, n_eta=1025)
    (part,) = cut(em.Mesh.uniform(grid), ())
    head = tmp_path / f"mesh{PARTED_FORMATS[name].suffix}"
    (small,) = cut(em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9)), ())
    write_part(tmp_path / f"small{PARTED_FORMATS[name].suffix}", small)  # imports
    tracemalloc.start()
    write_part(head, part, PartData(nodes={"u": lambda x, y: x + y}))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8.4e6, peak  # x alone has 8.4 MB, the points of a vtu 25 MB


def test_a_head_may_be_written_before_its_parts(tmp_path: Path) -> None:
    described = {"grid": DATA.mesh.grid, "cuts": CUTS[1], "nodes": ("u", "v"), "cells": ("Q_eq",)}
    for name in ("pvtu", "vtkhdf"):
        head = tmp_path / f"mesh{PARTED_FORMATS[name].suffix}"
        write_head(head, **described, parts_exist=False)
        for part in parts_of(CUTS[1]):
            write_part(head, part, data_of(part))
        np.testing.assert_array_equal(read_parts(head).rows("v", 0, len(ARRAYS["v"])), ARRAYS["v"])


def test_bad_input_is_refused(tmp_path: Path) -> None:
    (part,) = parts_of(())
    for path, reason in (
        (tmp_path / "mesh.vtu", "must end in .pvtu, .vtkhdf, .zarr"),
        (tmp_path / ".pvtu", "must end in"),
        (tmp_path / "none" / "mesh.pvtu", "there is no folder"),
    ):
        with pytest.raises(InputError, match=reason):
            write_part(path, part)
        with pytest.raises(InputError, match=reason):
            write_head(path, grid=part.grid, cuts=())
    with pytest.raises(InputError, match="unknown format 'vts' of parts"):
        write_part(tmp_path / "mesh.pvtu", part, format="vts")
    with pytest.raises(InputError, match=r"it must end in \.pvtu"):
        write_part(tmp_path / "mesh.zarr", part, format="pvtu")
    for cuts in ((0,), (5, 5), (97,), (-1,)):
        with pytest.raises(InputError, match="these must increase"):
            write_head(tmp_path / "mesh.pvtu", grid=part.grid, cuts=cuts)


def test_a_shared_folder_passes_and_stays_empty(tmp_path: Path) -> None:
    machine = leave_probe(tmp_path / "mesh.pvtu", "a1")
    assert machine == socket.gethostname()
    require_probe(tmp_path / "mesh.pvtu", "a1", machine)
    assert [*tmp_path.iterdir()] == []


def test_a_folder_of_the_worker_alone_is_refused(tmp_path: Path) -> None:
    """The worker's folder of the same name is another one."""
    (tmp_path / "worker").mkdir()
    machine = leave_probe(tmp_path / "worker" / "mesh.pvtu", "a1")
    with pytest.raises(InputError, match=f"what the worker on {machine} wrote to .* is not seen on"):
        require_probe(tmp_path / "mesh.pvtu", "a1", machine, seconds=0.1)
    with pytest.raises(InputError, match="is not seen on"):
        require_probe(tmp_path / "none" / "mesh.pvtu", "a1", machine, seconds=0.0)


def test_a_folder_that_the_worker_lacks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write to .*: No such file or directory\. Give a folder"):
        leave_probe(tmp_path / "none" / "mesh.pvtu", "a1")
