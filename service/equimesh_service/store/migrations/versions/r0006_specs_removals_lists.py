"""The size of each spec, which counts for its key; notes of files to be removed; meshes of a key as they are listed."""

import sqlalchemy as sa
from alembic import op

# Three steps of a development version, 0004 to 0006, are this one: its last database is one of this release.
revision = "0006"
down_revision = "0003"


def upgrade() -> None:
    """Specs of existing meshes count from now on; no removals are noted yet."""
    op.add_column("meshes", sa.Column("spec_size", sa.Integer, nullable=False, server_default="0"))
    # SQLite has octet_length() only since 3.43.
    size = "octet_length(spec)" if op.get_bind().dialect.name == "postgresql" else "length(CAST(spec AS BLOB))"
    op.execute(f"UPDATE meshes SET spec_size = {size}")
    # By the time at which meshes were made, since their numbers tell how many other meshes there are.
    op.drop_index("meshes_by_key", "meshes")
    op.create_index("meshes_by_key", "meshes", ["key_id", "created_at", "id", "spec_size"])
    op.create_table(
        "removals",
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("noted_at", sa.Float, nullable=False),
        sa.PrimaryKeyConstraint("sha256", "noted_at"),
    )
