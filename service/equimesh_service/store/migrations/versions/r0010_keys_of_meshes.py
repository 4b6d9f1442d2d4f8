"""An index of idempotency keys by their meshes."""

from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """A mesh that is deleted does not look through all keys."""
    op.create_index("ix_idempotency_mesh_id", "idempotency", ["mesh_id"])
