"""The sequences of a key in the order of their list, and the settings of steps."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Earlier steps have no settings."""
    op.create_index("sequences_by_key", "sequences", ["key_id", "created_at", "id"])
    op.add_column("steps", sa.Column("settings", sa.JSON(none_as_null=True)))
