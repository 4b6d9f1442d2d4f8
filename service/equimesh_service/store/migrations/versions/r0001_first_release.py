"""The tables of release 0.1, which made them without a record of their revision."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make what is not there: the first databases of 0.1 lack ``mesh_samples``."""
    tables().create_all(op.get_bind())


def tables() -> sa.MetaData:
    """The tables as release 0.1 described them."""
    metadata = sa.MetaData()
    _add_meshes(metadata)
    _add_what_meshes_have(metadata)
    _add_samples_and_keys(metadata)
    return metadata


def _add_meshes(metadata: sa.MetaData) -> None:
    sa.Table(
        "meshes",
        metadata,
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(40), nullable=False, unique=True),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("label", sa.Text),
        sa.Column("spec", sa.Text, nullable=False),
        sa.Column("samples_id", sa.String(80)),
        sa.Column("n_xi", sa.Integer, nullable=False),
        sa.Column("n_eta", sa.Integer, nullable=False),
        sa.Column("cells", sa.String(16), nullable=False),
        sa.Column("format", sa.String(16)),
        sa.Column("created_at", sa.Float, nullable=False),
        sa.Column("started_at", sa.Float),
        sa.Column("finished_at", sa.Float),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("losses", sa.Integer, nullable=False),
        sa.Column("owner", sa.String(64)),
        sa.Column("lease_until", sa.Float),
        sa.Column("last_event", sa.Integer, nullable=False),
        sa.Column("progress", sa.JSON),
        sa.Column("result", sa.JSON),
        sa.Column("error", sa.JSON),
        sa.Column("partial", sa.Boolean, nullable=False),
        sa.Index("meshes_by_status", "status", "number"),
        sqlite_autoincrement=True,
    )


def _add_what_meshes_have(metadata: sa.MetaData) -> None:
    sa.Table(
        "events",
        metadata,
        sa.Column("mesh_id", sa.String(40), sa.ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("time", sa.Float, nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("data", sa.JSON, nullable=False),
        sa.PrimaryKeyConstraint("mesh_id", "number"),
    )
    sa.Table(
        "artifacts",
        metadata,
        sa.Column("mesh_id", sa.String(40), sa.ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False, index=True),
        sa.Column("size", sa.Integer, nullable=False),
        sa.PrimaryKeyConstraint("mesh_id", "name"),
    )


def _add_samples_and_keys(metadata: sa.MetaData) -> None:
    sa.Table(
        "samples",
        metadata,
        sa.Column("id", sa.String(80), primary_key=True),
        sa.Column("sha256", sa.String(64), nullable=False, index=True),
        sa.Column("size", sa.Integer, nullable=False),
        sa.Column("summary", sa.JSON, nullable=False),
        sa.Column("created_at", sa.Float, nullable=False),
    )
    sa.Table(
        "mesh_samples",
        metadata,
        sa.Column("mesh_id", sa.String(40), sa.ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
        sa.Column("samples_id", sa.String(80), nullable=False, index=True),
        sa.PrimaryKeyConstraint("mesh_id", "samples_id"),
    )
    sa.Table(
        "idempotency",
        metadata,
        sa.Column("key", sa.String(255), primary_key=True),
        sa.Column("fingerprint", sa.String(64), nullable=False),
        sa.Column("mesh_id", sa.String(40), sa.ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    )
