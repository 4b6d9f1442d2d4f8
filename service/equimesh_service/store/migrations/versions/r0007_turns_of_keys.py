"""The share of each key, and an index in which a service finds the waiting meshes of each key."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """All keys have the same share."""
    op.add_column("keys", sa.Column("share", sa.Integer, nullable=False, server_default="1"))
    op.drop_index("meshes_by_status", "meshes")
    op.create_index("meshes_by_status", "meshes", ["status", "key_id", "number", "n_xi", "n_eta"])
