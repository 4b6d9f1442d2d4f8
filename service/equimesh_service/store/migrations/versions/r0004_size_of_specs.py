"""How many bytes the spec of each mesh has, which count for its key."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Specs that are there count from now on, too."""
    op.add_column("meshes", sa.Column("spec_size", sa.Integer, nullable=False, server_default="0"))
    # SQLite has octet_length() only since 3.43.
    size = "octet_length(spec)" if op.get_bind().dialect.name == "postgresql" else "length(CAST(spec AS BLOB))"
    op.execute(f"UPDATE meshes SET spec_size = {size}")
    op.drop_index("meshes_by_key", "meshes")
    op.create_index("meshes_by_key", "meshes", ["key_id", "number", "spec_size"])
