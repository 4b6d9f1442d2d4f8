"""API keys, whose meshes and samples these are, reuse, what was removed after its time, and 64-bit numbers."""

from time import time

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

_WIDENED = (
    ("meshes", "number"),
    ("meshes", "last_event"),
    ("events", "number"),
    ("artifacts", "size"),
    ("samples", "size"),
)


def upgrade() -> None:
    """All that is there belongs to no key."""
    if op.get_bind().dialect.name == "postgresql":
        for table, column in _WIDENED:
            op.alter_column(table, column, type_=sa.BigInteger)
        op.execute("ALTER SEQUENCE meshes_number_seq AS bigint")
    _meshes()
    _samples()
    _idempotency()
    op.create_table(
        "retired",
        sa.Column("id", sa.String(80), nullable=False),
        sa.Column("key_id", sa.String(40), nullable=False),
        sa.Column("retired_at", sa.Float, nullable=False),
        sa.PrimaryKeyConstraint("id", "key_id"),
        sa.Index("retired_by_time", "retired_at"),
    )
    op.create_table(
        "keys",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("scopes", sa.JSON, nullable=False),
        sa.Column("created_at", sa.Float, nullable=False),
        sa.Column("revoked_at", sa.Float),
    )


def _meshes() -> None:
    op.add_column("meshes", sa.Column("key_id", sa.String(40), nullable=False, server_default=""))
    op.add_column("meshes", sa.Column("fingerprint", sa.String(64)))
    op.add_column("meshes", sa.Column("reused_from", sa.String(40)))
    op.add_column("meshes", sa.Column("request_id", sa.String(64)))
    op.add_column("meshes", sa.Column("trace", sa.String(64)))
    op.drop_index("meshes_by_status", "meshes")
    op.create_index("meshes_by_status", "meshes", ["status", "number", "key_id", "n_xi", "n_eta"])
    # Release 0.1 kept everything: the time after which it is removed begins now.
    op.add_column("meshes", sa.Column("kept_from", sa.Float))
    op.execute(sa.text("UPDATE meshes SET kept_from = :now").bindparams(now=time()))
    op.create_index("meshes_by_key", "meshes", ["key_id", "number"])
    op.create_index("meshes_by_fingerprint", "meshes", ["fingerprint", "key_id", "number"])
    op.create_index("meshes_by_finish", "meshes", ["finished_at"])
    # The samples of meshes from the first days of 0.1 stood in the mesh itself.
    op.execute(
        "INSERT INTO mesh_samples (mesh_id, samples_id) SELECT id, samples_id FROM meshes WHERE samples_id IS NOT NULL "
        "AND NOT EXISTS (SELECT 1 FROM mesh_samples AS m WHERE m.mesh_id = meshes.id "
        "AND m.samples_id = meshes.samples_id)"
    )
    op.drop_column("meshes", "samples_id")


def _samples() -> None:
    op.add_column("samples", sa.Column("used_at", sa.Float, nullable=False, server_default="0"))
    op.execute(sa.text("UPDATE samples SET used_at = :now").bindparams(now=time()))
    op.create_table(
        "samples_keys",
        sa.Column("samples_id", sa.String(80), sa.ForeignKey("samples.id", ondelete="CASCADE"), nullable=False),
        sa.Column("key_id", sa.String(40), nullable=False),
        sa.Column("created_at", sa.Float, nullable=False),
        sa.PrimaryKeyConstraint("samples_id", "key_id"),
        sa.Index("samples_by_key", "key_id"),
    )
    op.execute("INSERT INTO samples_keys (samples_id, key_id, created_at) SELECT id, '', created_at FROM samples")


def _idempotency() -> None:
    # SQLite cannot change a primary key, so the table is made anew.
    op.execute("CREATE TEMPORARY TABLE idempotency_old AS SELECT key, fingerprint, mesh_id FROM idempotency")
    op.drop_table("idempotency")
    op.create_table(
        "idempotency",
        sa.Column("key_id", sa.String(40), nullable=False, server_default=""),
        sa.Column("key", sa.String(255), nullable=False),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("mesh_id", sa.String(40), sa.ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
        sa.PrimaryKeyConstraint("key_id", "key"),
    )
    op.execute(
        "INSERT INTO idempotency (key_id, key, fingerprint, mesh_id) "
        "SELECT '', key, fingerprint, mesh_id FROM idempotency_old"
    )
    op.drop_table("idempotency_old")
