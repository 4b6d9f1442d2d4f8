"""Other users of the machine cannot read what a service writes."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import httpx
import pytest

from cli.conftest import look
from equimesh_cli import main
from equimesh_cli.checks import installation
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings
from equimesh_service.files.folder import clear, make_folder
from service.conftest import small
from service.observed import Observed


def readable_by_others(folder: Path) -> list[str]:
    """The files and folders below a folder, itself included, that are not for its owner alone."""
    found = [folder, *folder.rglob("*")]
    return [str(path.relative_to(folder)) for path in found if stat.S_IMODE(path.stat().st_mode) & 0o077]


def test_a_service_hides_its_data(observed: Observed) -> None:
    with httpx.Client(base_url=observed.url, timeout=600.0) as http:
        spec = small(grid={"n_xi": 120, "n_eta": 120})
        mesh = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}).json()
        assert http.get(f"/v1/meshes/{mesh['id']}/file", params={"format": "vtu"}).status_code == 200
    data = observed.log.parent / "data"
    assert len([path for path in data.rglob("*") if path.is_file()]) >= 5  # also a large one, which a worker wrote
    assert readable_by_others(data) == []


def test_commands_hide_what_they_make(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = os.umask(0o022)
    try:
        assert main(["keys", "create", "--name", "ada", "--data-dir", str(tmp_path / "keys")]) == 0
        assert main(["database", "upgrade", "--data-dir", str(tmp_path / "upgrade")]) == 0
        copy = tmp_path / "copy.sqlite3"
        assert main(["database", "backup", "--data-dir", str(tmp_path / "keys"), str(copy)]) == 0
    finally:
        os.umask(before)
    assert readable_by_others(tmp_path / "keys") == readable_by_others(tmp_path / "upgrade") == []
    assert stat.S_IMODE(copy.stat().st_mode) == 0o600
    assert "em_" in capsys.readouterr().out


def test_a_folder_that_exists_keeps_its_permissions(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o750)
    make_folder(shared)
    assert stat.S_IMODE(shared.stat().st_mode) == 0o750


def test_doctor_warns_of_a_database_that_others_can_read(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    assert main(["database", "upgrade", "--data-dir", str(folder)]) == 0
    settings = Settings(data_dir=folder)
    assert look(installation.folder, settings).level is Level.OK
    (folder / "equimesh.sqlite3").chmod(0o644)
    assert look(installation.folder, settings).level is Level.OK  # the folder keeps others out
    folder.chmod(0o755)
    finding = look(installation.folder, settings)
    assert finding.level is Level.WARNING
    assert f"chmod -R go= {folder}" in finding.remedy


# Folders of files that are being written.


def test_a_start_clears_the_folders_of_killed_writers_too(tmp_path: Path) -> None:
    folder = tmp_path / "unfinished"
    (folder / ".equimesh-abc").mkdir(parents=True)
    (folder / ".equimesh-abc" / "mesh.vtu").write_text("half")
    (folder / "x.npz").write_text("half")
    clear(folder, alone=False)  # of another service, perhaps, that is at work
    assert len([*folder.iterdir()]) == 2
    clear(folder, alone=True)
    assert [*folder.iterdir()] == []
