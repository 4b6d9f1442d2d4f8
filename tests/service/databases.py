"""Databases for tests: every test gets its own, in SQLite and in PostgreSQL.

PostgreSQL is the server behind ``EQUIMESH_TEST_POSTGRES`` (an address whose user may create schemas), else one that
is started here from the programs of the system, in a temporary folder, without a port.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import pytest
from sqlalchemy import create_engine, make_url, text

from programs import postgresql_program

ADDRESS = "EQUIMESH_TEST_POSTGRES"
NEEDED = "EQUIMESH_TEST_POSTGRES_NEEDED"


@dataclass(frozen=True)
class Postgres:
    """A server: ``url`` is its address, ``folder`` the folder of a server that the tests have started."""

    url: str
    folder: Path | None = None
    numbers: Iterator[int] = field(default_factory=count)

    @contextmanager
    def database(self) -> Iterator[str]:
        """The address of a new schema, which takes much less time than a new database."""
        name = f"equimesh_test_{os.getpid()}_{next(self.numbers)}"
        self._run(f"CREATE SCHEMA {name}")
        address = make_url(self.url).update_query_dict({"options": f"-csearch_path={name}"})
        yield address.render_as_string(hide_password=False)
        self._run(f"DROP SCHEMA {name} CASCADE")

    def stop(self) -> None:
        """Stop the tests' own server at once, breaking all connections."""
        assert self.folder is not None
        _program(self.folder, "pg_ctl", "stop", "-w", "-m", "fast", "-D", f"{self.folder}/data")

    def start(self) -> None:
        """Start the tests' own server."""
        assert self.folder is not None
        # Without a port, and without waiting for the disk.
        options = f"-c listen_addresses= -c unix_socket_directories={self.folder} -c fsync=off -c max_connections=200"
        log = f"{self.folder}/log"
        _program(self.folder, "pg_ctl", "start", "-w", "-D", f"{self.folder}/data", "-l", log, "-o", options)

    def _run(self, statement: str) -> None:
        engine = create_engine(self.url, isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(text(statement))
        engine.dispose()


@contextmanager
def postgres_server(*, own: bool = False) -> Iterator[Postgres]:
    """A server for the length of a ``with``, which may be stopped if it is ``own``."""
    given = os.environ.get(ADDRESS)
    if given and not own:
        yield Postgres(given)
        return
    if postgresql_program("initdb") is None:
        pytest.skip("the given server must not be stopped, and there are no programs to start another one")
    folder = Path(tempfile.mkdtemp(prefix="equimesh-pg-"))
    try:
        if os.getuid() == 0:  # the programs refuse root
            shutil.chown(folder, "postgres", "postgres")
        _program(folder, "initdb", "-U", "postgres", "-A", "trust", "--no-sync", "-D", f"{folder}/data")
        server = Postgres(f"postgresql+psycopg://postgres@/postgres?host={folder}", folder)
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder)


@contextmanager
def database(kind: str, folder: Path, request: pytest.FixtureRequest) -> Iterator[str]:
    """The address of an empty database of this kind, ``sqlite`` or ``postgresql``."""
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'test.sqlite3'}"
        return
    server: Postgres = request.getfixturevalue("postgres")
    with server.database() as url:
        yield url


def _program(folder: Path, name: str, *arguments: str) -> None:
    found = postgresql_program(name)
    assert found is not None
    user = "postgres" if os.getuid() == 0 else None
    groups: list[str] | None = [] if user else None
    command = [found, *arguments]
    with (folder / "out").open("w") as out:  # a pipe would stay open in the server
        done = subprocess.run(
            command, cwd=folder, stdout=out, stderr=subprocess.STDOUT, user=user, group=user, extra_groups=groups
        )
    assert done.returncode == 0, (folder / "out").read_text()
