"""Sequences of meshes that follow a time-stepper, and their steps."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """There are none yet."""
    op.create_table(
        "sequences",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("key_id", sa.String(40), nullable=False, server_default=""),
        sa.Column("keep", sa.Integer, nullable=False),
        sa.Column("created_at", sa.Float, nullable=False),
        sa.Column("used_at", sa.Float, nullable=False),
    )
    op.create_table(
        "steps",
        sa.Column("mesh_id", sa.String(40), sa.ForeignKey("meshes.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("sequence_id", sa.String(40), sa.ForeignKey("sequences.id", ondelete="CASCADE"), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("start", sa.String(64)),
        sa.Column("fields", sa.String(64)),
        sa.Index("steps_by_sequence", "sequence_id", "number", unique=True),
    )
