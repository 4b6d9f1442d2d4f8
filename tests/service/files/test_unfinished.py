"""Folders of files that are being written."""

from __future__ import annotations

from pathlib import Path

from equimesh_service.files.folder import clear


def test_a_start_clears_the_folders_of_killed_writers_too(tmp_path: Path) -> None:
    folder = tmp_path / "unfinished"
    (folder / ".equimesh-abc").mkdir(parents=True)
    (folder / ".equimesh-abc" / "mesh.vtu").write_text("half")
    (folder / "x.npz").write_text("half")
    clear(folder, alone=False)  # of another service, perhaps, that is at work
    assert len([*folder.iterdir()]) == 2
    clear(folder, alone=True)
    assert [*folder.iterdir()] == []
