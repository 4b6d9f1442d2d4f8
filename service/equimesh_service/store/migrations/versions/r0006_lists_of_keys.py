"""The meshes of a key in the order in which they are listed."""

from __future__ import annotations

from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """By the time they were made, since their numbers tell how many others there are."""
    op.drop_index("meshes_by_key", "meshes")
    op.create_index("meshes_by_key", "meshes", ["key_id", "created_at", "id", "spec_size"])
