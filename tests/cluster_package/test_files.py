"""Files of a mesh on a cluster."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from distributed import Client

import equimesh as em
from equimesh_cluster import PARTED_FORMATS, read_parts
from meshes_on_workers import PROBLEM, handle_on


@pytest.mark.parametrize("name", PARTED_FORMATS)
def test_every_worker_writes_its_part_and_the_caller_the_head(client: Client, tmp_path: Path, name: str) -> None:
    solution = em.solve(PROBLEM)
    head = tmp_path / f"mesh{PARTED_FORMATS[name].suffix}"
    with handle_on(client, solution, 10, 20) as handle:
        assert handle.write(head) == head
    found = read_parts(head)
    assert found.nodes == ("u",)
    assert sorted(found.cells) == ["Q_eq", "subdomain"]
    assert found.cuts == (10, 20)
    for array, whole in (("x", solution.mesh.x), ("y", solution.mesh.y), ("u", solution.u)):
        assert np.array_equal(found.rows(array, 0, 33), whole)
    assert found.rows("Q_eq", 0, 32) == pytest.approx(solution.data().q_eq, rel=1e-12, abs=0)
    assert not list(tmp_path.glob(".equimesh-*"))


def test_q_eq_is_left_out_on_request(client: Client, tmp_path: Path) -> None:
    with handle_on(client, em.solve(PROBLEM), 16) as handle:
        handle.write(tmp_path / "mesh.pvtu", q_eq=False)
    assert tuple(read_parts(tmp_path / "mesh.pvtu").cells) == ("subdomain",)


def test_a_folder_that_is_not_there_is_refused(client: Client, tmp_path: Path) -> None:
    with (
        handle_on(client, em.solve(PROBLEM), 16) as handle,
        pytest.raises(em.InputError, match=r"there is no folder .*nowhere on this machine"),
    ):
        handle.write(tmp_path / "nowhere" / "mesh.pvtu")
    with handle_on(client, em.solve(PROBLEM), 16) as handle, pytest.raises(em.InputError, match="pvtu"):
        handle.write(tmp_path / "mesh.doc")
