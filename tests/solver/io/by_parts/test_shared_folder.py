"""A folder that is not shared is found out before a mesh is written."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from equimesh.errors import InputError
from equimesh.io.by_parts.shared_folder import leave_probe, require_probe


def test_a_shared_folder_passes_and_stays_empty(tmp_path: Path) -> None:
    machine = leave_probe(tmp_path / "mesh.pvts", "a1")
    assert machine == socket.gethostname()
    require_probe(tmp_path / "mesh.pvts", "a1", machine)
    assert [*tmp_path.iterdir()] == []


def test_a_folder_of_the_worker_alone_is_refused(tmp_path: Path) -> None:
    """The worker's folder of the same name is another one."""
    (tmp_path / "worker").mkdir()
    machine = leave_probe(tmp_path / "worker" / "mesh.pvts", "a1")
    with pytest.raises(InputError, match=f"what the worker on {machine} wrote to .* is not seen on"):
        require_probe(tmp_path / "mesh.pvts", "a1", machine, seconds=0.1)
    with pytest.raises(InputError, match="is not seen on"):
        require_probe(tmp_path / "none" / "mesh.pvts", "a1", machine, seconds=0.0)


def test_a_folder_that_the_worker_lacks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write to .*: No such file or directory\. Give a folder"):
        leave_probe(tmp_path / "none" / "mesh.pvts", "a1")
