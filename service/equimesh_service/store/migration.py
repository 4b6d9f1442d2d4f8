"""The revision of a database's tables, and its upgrade to that of this release."""

import logging

from sqlalchemy import Column, Connection, MetaData, String, Table, insert, inspect, select

from equimesh_service.errors import NewerDatabaseError
from equimesh_service.store.database import Database, lock
from equimesh_service.store.schema import artifacts, meshes, metadata

# The revision of the tables in `schema`: that of the last step in `migrations`.
LATEST = "0008"
_FIRST = "0001"
# The revisions that this release can upgrade from.
_OLDER = (_FIRST, "0002", "0003", "0006", "0007")
_log = logging.getLogger(__name__)
# The table of Alembic, as Alembic creates it.
_version = Table("alembic_version", MetaData(), Column("version_num", String(32), primary_key=True))


def current(url: str) -> str | None:
    """The revision of the database behind ``url``; None for one without tables."""
    database = Database(url, durable=True)
    try:
        with database.read() as connection:
            return _revision(connection)
    finally:
        database.close()


def upgrade(url: str) -> str:
    """Upgrade the database behind ``url`` to this release; returns its new revision.

    Raises :class:`NewerDatabaseError`.
    """
    database = Database(url, durable=True)
    try:
        return prepare(database)
    finally:
        database.close()


def prepare(database: Database) -> str:
    """Create the tables, or upgrade those of an older release with their rows; returns the revision.

    All in one transaction; other services that do the same wait for it. Raises :class:`NewerDatabaseError`.
    """
    with database.read() as connection:
        if _revision(connection) == LATEST:
            return LATEST  # most starts end here, without a lock and without alembic
    with database.write() as connection:
        lock(connection, ["migration"])
        revision = _revision(connection)
        if revision is None:
            metadata.create_all(connection)
            _version.create(connection)
            connection.execute(insert(_version).values(version_num=LATEST))
        elif revision != LATEST:
            _log.info("the database has revision %s; it is upgraded to %s", revision, LATEST)
            _run(connection)
    return LATEST


def _revision(connection: Connection) -> str | None:
    tables = set(inspect(connection).get_table_names())
    if _version.name not in tables:
        # Release 0.1 stored no revision.
        return _FIRST if {meshes.name, artifacts.name} <= tables else None
    found = connection.execute(select(_version.c.version_num)).scalar()
    if found != LATEST and found not in _OLDER:
        raise NewerDatabaseError(
            f"the database is of revision {found}, of a newer release of equimesh or a development version; "
            f"this release knows {LATEST}: install that version again, or restore a backup from before it"
        )
    return str(found)


def _run(connection: Connection) -> None:
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", "equimesh_service.store:migrations")
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
