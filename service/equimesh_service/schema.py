"""The tables: their columns are the service's memory."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    PrimaryKeyConstraint,
    String,
    Table,
    Text,
)

metadata = MetaData()

# One row per mesh that was asked for. `attempt` counts claims and fences writers: a worker may write only
# while the row still has the worker's attempt. `losses` counts the attempts whose worker was lost.
meshes = Table(
    "meshes",
    metadata,
    Column("number", Integer, primary_key=True, autoincrement=True),
    Column("id", String(40), nullable=False, unique=True),
    Column("status", String(16), nullable=False),
    Column("label", Text),
    Column("spec", Text, nullable=False),
    Column("samples_id", String(80)),  # of meshes from version 0.1; newer ones are in mesh_samples
    Column("n_xi", Integer, nullable=False),
    Column("n_eta", Integer, nullable=False),
    Column("cells", String(16), nullable=False),
    Column("format", String(16)),
    Column("created_at", Float, nullable=False),
    Column("started_at", Float),
    Column("finished_at", Float),
    Column("attempt", Integer, nullable=False, default=0),
    Column("losses", Integer, nullable=False, default=0),
    Column("owner", String(64)),
    Column("lease_until", Float),
    Column("last_event", Integer, nullable=False, default=0),
    Column("progress", JSON(none_as_null=True)),
    Column("result", JSON(none_as_null=True)),
    Column("error", JSON(none_as_null=True)),
    Column("partial", Boolean, nullable=False, default=False),
    Index("meshes_by_status", "status", "number"),
    sqlite_autoincrement=True,
)

# What happened to a mesh, in order; rows are only added. `number` runs 1, 2, 3, … for each mesh.
events = Table(
    "events",
    metadata,
    Column("mesh_id", String(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("time", Float, nullable=False),
    Column("kind", String(16), nullable=False),
    Column("data", JSON, nullable=False),
    PrimaryKeyConstraint("mesh_id", "number"),
)

# Files that belong to a mesh, by name: "mesh", "file:vtu:quad", "quality", "plot:mesh:svg", …
artifacts = Table(
    "artifacts",
    metadata,
    Column("mesh_id", String(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    Column("name", String(64), nullable=False),
    Column("sha256", String(64), nullable=False, index=True),
    Column("size", Integer, nullable=False),
    PrimaryKeyConstraint("mesh_id", "name"),
)

# Uploaded samples; the id is made of the SHA-256 of their canonical npz file.
samples = Table(
    "samples",
    metadata,
    Column("id", String(80), primary_key=True),
    Column("sha256", String(64), nullable=False, index=True),
    Column("size", Integer, nullable=False),
    Column("summary", JSON, nullable=False),
    Column("created_at", Float, nullable=False),
)

# Which samples a mesh uses.
mesh_samples = Table(
    "mesh_samples",
    metadata,
    Column("mesh_id", String(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    Column("samples_id", String(80), nullable=False, index=True),
    PrimaryKeyConstraint("mesh_id", "samples_id"),
)

# Keys of requests that must not act twice.
idempotency = Table(
    "idempotency",
    metadata,
    Column("key", String(255), primary_key=True),
    Column("fingerprint", String(64), nullable=False),
    Column("mesh_id", String(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
)
