"""The commands of docs/how-to/back-up.md, on a busy service and on PostgreSQL: lost data is restored."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import create_engine, insert, make_url, text

from equimesh_cli import main
from equimesh_service import Settings, running
from equimesh_service.store.database import LATEST, current, upgrade
from equimesh_service.store.schema import samples
from programs import postgresql_program
from service.conftest import small
from service.databases import Postgres
from service.store.first_release import FIRST

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "back-up.md").read_text()


def documented(mark: str) -> str:
    (code,) = re.findall(rf"<!-- {mark} -->\n```shell\n(.*?)```", PAGE, re.DOTALL)
    return str(code).replace("2026-01-31", date.today().isoformat())


def run(mark: str, folder: Path, **variables: str) -> str:
    """The output of the commands of the page, run in their folder, with the PGDATABASE of the page."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("EQUIMESH_")}
    path = os.pathsep.join([str(Path(sys.executable).parent), plain["PATH"]])
    code, name = documented(mark), variables.get("PGDATABASE", "equimesh")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", re.sub(r"(?<=dbname=)equimesh|equimesh$", name, code, flags=re.M)],
        cwd=folder,
        env={**plain, "PATH": path, "OPENBLAS_NUM_THREADS": "1", **variables},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@contextmanager
def at_work(url: str) -> Iterator[None]:
    """A client that requests meshes all the time."""
    stop = threading.Event()

    def ask() -> None:
        for number in itertools.takewhile(lambda _: not stop.wait(0.03), itertools.count(1)):
            spec = {**small(), "monitor": {"kind": "arc_length", "u": {"expression": f"x + {number}*y*y"}}}
            answer = httpx.post(f"{url}/v1/meshes", json=spec, headers={"Prefer": "wait=5"}, timeout=300.0)
            assert answer.status_code in (200, 201, 202)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def file_of(http: httpx.Client, mesh_id: str) -> bytes:
    answer = http.get(f"/v1/meshes/{mesh_id}/file", params={"format": "npz"})
    assert answer.status_code == 200, answer.text
    return answer.content


def test_a_service_at_work_is_backed_up_and_restored(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "equimesh-data", port=0, workers=1, log_level="warning")
    with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
        before: dict[str, bytes] = {}
        for number in range(3):
            spec = {**small(), "grid": {"n_xi": 8 + number, "n_eta": 9}}
            mesh = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}).json()
            before[mesh["id"]] = file_of(http, mesh["id"])
        with at_work(url):
            run("sqlite: back up", tmp_path)
    said = run("sqlite: restore", tmp_path, EQUIMESH_PORT="0", EQUIMESH_WORKERS="1")
    (files,) = re.findall(r"^ok +stored +all (\d+) files in the database exist$", said, re.MULTILINE)
    assert int(files) >= 3
    with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
        assert {mesh_id: file_of(http, mesh_id) for mesh_id in before} == before


def test_a_database_of_postgresql_is_backed_up_and_restored(tmp_path: Path, postgres: Postgres) -> None:
    if postgres.folder is None:
        pytest.skip("the given server is not ours to make databases on")
    name = f"equimesh_backup_{os.getpid()}"
    address = make_url(postgres.url).set(database=name)
    variables = {
        "PATH": os.pathsep.join(
            [str(Path(postgresql_program("pg_dump") or "").parent), str(Path(sys.executable).parent), "/bin"]
        ),
        "PGHOST": str(postgres.folder),
        "PGUSER": "postgres",
        "PGDATABASE": name,
        "EQUIMESH_DATABASE_URL": address.render_as_string(hide_password=False),
        "EQUIMESH_PORT": "0",
    }
    kept = tmp_path / "equimesh-data" / "files" / "ab" / ("ab" * 32)
    server = create_engine(postgres.url, isolation_level="AUTOCOMMIT")
    with server.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    try:
        upgrade(variables["EQUIMESH_DATABASE_URL"])
        engine = create_engine(address)
        row = {"id": "s", "sha256": kept.name, "size": 5, "summary": {}, "created_at": 1.0, "used_at": 1.0}
        with engine.begin() as connection:
            connection.execute(insert(samples).values(row))
        kept.parent.mkdir(parents=True)
        kept.write_bytes(b"12345")
        run("postgresql: back up", tmp_path, **variables)
        with engine.begin() as connection:
            connection.execute(samples.delete())
        engine.dispose()
        kept.write_bytes(b"")
        said = run("postgresql: restore", tmp_path, **variables)
        assert "all 1 files in the database exist" in said
        assert kept.read_bytes() == b"12345"
    finally:
        with server.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        server.dispose()


def test_the_command_shows_upgrades_and_copies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def database(*words: str) -> tuple[int, Any, str]:
        code = main(["database", *words, "--json", "--data-dir", str(tmp_path / "data")])
        said = capsys.readouterr()
        return code, json.loads(said.out) if said.out else None, said.err

    copy = tmp_path / "copy.sqlite3"
    assert database("current")[:2] == (0, {"current": None, "latest": LATEST})
    assert not (tmp_path / "data").exists()
    assert database("backup", str(copy))[0] == 2
    assert not copy.exists()
    (tmp_path / "data").mkdir()
    engine = create_engine(f"sqlite:///{tmp_path}/data/equimesh.sqlite3")
    FIRST.create_all(engine)
    engine.dispose()
    assert database("current")[1]["current"] == "0001"
    assert database("backup", str(copy))[:2] == (0, {"file": str(copy), "bytes": copy.stat().st_size})
    assert copy.stat().st_mode & 0o777 == 0o600
    assert database("upgrade")[:2] == (0, {"current": LATEST})
    assert current(f"sqlite:///{copy}") == "0001"
    code, _, said = database("backup", str(copy))
    assert (code, said) == (2, f"equimesh: {copy} exists already: choose another name, or remove it first\n")
    assert main(["database", "backup", str(tmp_path / "x"), "--database-url", "postgresql://h/n"]) == 2
    assert "pg_dump" in capsys.readouterr().err
    assert main(["database", "current", "--database-url", "postgresql://ada:hidden@127.0.0.1:1/n"]) == 3
    assert "hidden" not in capsys.readouterr().err
