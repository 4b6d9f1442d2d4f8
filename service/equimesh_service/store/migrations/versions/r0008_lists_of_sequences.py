"""The sequences of a key in the order of their list."""

from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Rows stay as they are."""
    op.create_index("sequences_by_key", "sequences", ["key_id", "created_at", "id"])
