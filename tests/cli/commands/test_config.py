"""`equimesh config`: every setting, where it comes from, and no secret."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from equimesh_cli import main
from equimesh_service.settings import Settings, find_unknown, groups

SECRETS = {
    "EQUIMESH_DATABASE_URL": "postgresql+psycopg://ada:hidden1@db.example/meshes?password=hidden2&sslmode=require",
    "EQUIMESH_FILES_URL": "s3://user:hidden3@bucket/prefix",
    "EQUIMESH_S3_SECRET_KEY": "hidden4",
    "EQUIMESH_S3_ENDPOINT": "https://user:hidden5@s3.example",
    "EQUIMESH_TRACE_ENDPOINT": "http://host:4318/v1/traces?token=hidden6",
}


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.upper().startswith("EQUIMESH_")]:
        monkeypatch.delenv(name)


def config(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, dict[str, Any]]:
    assert main(["config", "--json", *words]) == 0
    return {row["name"]: row for row in json.loads(capsys.readouterr().out)["settings"]}


def test_every_setting_is_shown_with_its_source(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_PORT", "9000")
    monkeypatch.setenv("EQUIMESH_LEASE", "20")
    monkeypatch.setenv("equimesh_poll", "0.5")  # variables may be written small
    rows = config(capsys, "--lease", "30", "--reuse", "false")
    assert list(rows) == list(Settings.model_fields)
    assert all(row["variable"] == f"EQUIMESH_{name.upper()}" for name, row in rows.items())
    sources = {name: row["source"] for name, row in rows.items() if row["source"] != "default"}
    assert sources == {"port": "environment", "poll": "environment", "lease": "option", "reuse": "option"}
    assert [rows[name]["value"] for name in ("port", "poll", "lease", "reuse")] == [9000, 0.5, 30.0, False]
    assert main(["config"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  ")] == list(Settings.model_fields)
    assert lines[2].split() == ["port", "environment", "9000"]
    assert [line for line in lines if line and not line.startswith(" ")] == list(groups())
    assert list(dict.fromkeys(row["group"] for row in rows.values())) == list(groups())


@pytest.mark.parametrize("form", ["--json", "--env", None])
def test_no_secret_is_shown(
    form: str | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in SECRETS.items():
        monkeypatch.setenv(name, value)
    assert main(["config", *([form] if form else [])]) == 0
    said = capsys.readouterr().out
    assert "hidden" not in said.replace('"hidden"', "")
    assert "db.example/meshes" in said
    assert "bucket/prefix" in said
    assert main(["config", "--database-url", "hidden7 that is no address"]) == 0
    assert "hidden7" not in capsys.readouterr().out


def test_its_lines_give_the_same_settings_again(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    odd = tmp_path / 'it\'s a "folder" of $HOME'
    assert main(["config", "--env", "--port", "9000", "--data-dir", str(odd), "--root-path", "/meshes"]) == 0
    lines = capsys.readouterr().out
    assert "\n# EQUIMESH_WORKERS=" in lines
    file = tmp_path / "env"
    file.write_text(lines)
    read = subprocess.run(
        ["sh", "-c", f". '{file}'; printf %s \"$EQUIMESH_DATA_DIR\""], capture_output=True, text=True, check=True
    )
    assert read.stdout == str(odd)
    names = [line.partition("=")[0] for line in lines.splitlines() if line and not line.startswith("#")]
    assert names == ["EQUIMESH_PORT", "EQUIMESH_ROOT_PATH", "EQUIMESH_DATA_DIR"]


def test_unknown_variables_are_named_with_the_nearest(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EQUIMESH_WORKRES", "3")
    monkeypatch.setenv("EQUIMESH_KEY", "a client's")
    assert main(["config"]) == 0
    said = capsys.readouterr().err
    assert said == "equimesh: EQUIMESH_WORKRES is no setting, and is ignored; did you mean EQUIMESH_WORKERS?\n"
    assert find_unknown({"EQUIMESH_ZZZ": "", "PATH": "", "EQUIMESH_URL": ""}) == {"EQUIMESH_ZZZ": None}


def test_a_bad_value_is_refused_as_by_serve(capsys: pytest.CaptureFixture[str]) -> None:
    said = []
    for command in ("serve", "config", "doctor"):
        assert main([command, "--port", "many"]) == 2
        said.append(capsys.readouterr().err)
    assert said[0].startswith("equimesh: --port (or EQUIMESH_PORT) = many: ")
    assert len(set(said)) == 1


def test_settings_without_a_database_address_load_no_large_package() -> None:
    large = ("numpy", "scipy", "numba", "equimesh", "fastapi", "sqlalchemy", "httpx", "matplotlib")
    code = (
        "import sys; from equimesh_cli import main; main(['config', '--json']);"
        f"print([name for name in {large} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr == "[]\n"
