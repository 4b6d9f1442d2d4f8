"""The script that gives the service a role of its own, on a server here."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from sqlalchemy import create_engine, make_url, text
from sqlalchemy.exc import DBAPIError

from equimesh_service.store.database import LATEST, current, upgrade
from programs import postgresql_program
from service.databases import Postgres, postgres_server

ROOT = Path(__file__).parents[2]
PASSWORD = "it's: @/?# \\ $x"
FORBIDDEN = (
    "CREATE TABLE public.mine (number int)",
    "CREATE SCHEMA another",
    "CREATE ROLE another",
    "CREATE DATABASE another",
    "COPY (SELECT 1) TO PROGRAM 'true'",
    "SELECT rolpassword FROM pg_authid",
)


def give_role(server: Postgres) -> None:
    """Run the script, as the container of PostgreSQL does when it makes a new volume."""
    programs = Path(postgresql_program("psql") or "").parent
    variables = {"PATH": f"{programs}:/usr/bin:/bin", "PGHOST": str(server.folder), "POSTGRES_PASSWORD": PASSWORD}
    script = [ROOT / "deploy/postgres/own-schema.sh"]
    done = subprocess.run(script, env=variables, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


def ask(address: str, statement: str) -> list[tuple[object, ...]]:
    """The rows of a statement in a transaction of its own."""
    engine = create_engine(address, isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            found = connection.execute(text(statement))
            return [tuple(row) for row in found] if found.returns_rows else []
    finally:
        engine.dispose()


@pytest.mark.needs("postgresql")
def test_the_role_owns_one_schema_and_nothing_else() -> None:
    """On a database whose tables are in `public`, as in release 0.2; and once more."""
    with postgres_server(own=True) as server:
        ask(server.url, "CREATE DATABASE equimesh")
        superuser = make_url(server.url).set(database="equimesh").render_as_string(hide_password=False)
        address = superuser.replace("postgres@", "equimesh@")
        upgrade(superuser)
        for _ in range(2):
            give_role(server)
            assert current(address) == LATEST
            owners = "SELECT DISTINCT schemaname, tableowner FROM pg_tables WHERE tablename IN ('meshes', 'keys')"
            assert ask(address, owners) == [("equimesh", "equimesh")]
        ask(superuser, "DROP SCHEMA equimesh CASCADE")
        give_role(server)
        assert upgrade(address) == LATEST  # as on a new volume
        for statement in FORBIDDEN:
            with pytest.raises(DBAPIError, match="InsufficientPrivilege"):
                ask(address, statement)
        with pytest.raises(DBAPIError, match="permission denied for database"):
            ask(address.replace("/equimesh?", "/postgres?"), "SELECT 1")
        passwords = "SELECT rolname, rolpassword LIKE 'SCRAM-SHA-256$%' FROM pg_authid WHERE rolcanlogin ORDER BY 1"
        assert ask(superuser, passwords) == [("equimesh", True), ("postgres", None)]
