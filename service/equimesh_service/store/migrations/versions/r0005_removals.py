"""Notes of files that are about to be removed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """There are none yet."""
    op.create_table(
        "removals",
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("noted_at", sa.Float, nullable=False),
        sa.PrimaryKeyConstraint("sha256", "noted_at"),
    )
