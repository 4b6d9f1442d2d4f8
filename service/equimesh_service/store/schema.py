"""The tables of the database."""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    PrimaryKeyConstraint,
    String,
    Table,
    Text,
    TypeDecorator,
)

metadata = MetaData()

# Numbers that clients send back, and sizes: 64 bits. In SQLite only the type Integer counts up by itself.
_Number = BigInteger().with_variant(Integer, "sqlite")


class _Id(TypeDecorator[str]):
    """Ids. A client may send U+0000, which PostgreSQL refuses to compare, and which no id contains."""

    impl = String
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Any) -> str | None:  # noqa: ARG002
        return None if value is None else value.replace("\x00", "\ufffd")


# One row for each requested mesh. `attempt` counts claims and fences writers: a worker may write only while the row has
# the worker's attempt. `losses` counts the attempts whose worker was lost. `owner` is the service with the claim.
# `key_id` is the API key of the request, "" without one.
meshes = Table(
    "meshes",
    metadata,
    Column("number", _Number, primary_key=True, autoincrement=True),
    Column("id", _Id(40), nullable=False, unique=True),
    Column("status", String(16), nullable=False),
    Column("label", Text),
    Column("spec", Text, nullable=False),
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
    Column("last_event", _Number, nullable=False, default=0),
    Column("progress", JSON(none_as_null=True)),
    Column("result", JSON(none_as_null=True)),
    Column("error", JSON(none_as_null=True)),
    Column("partial", Boolean, nullable=False, default=False),
    Column("key_id", _Id(40), nullable=False, server_default=""),
    Column("fingerprint", String(64)),  # equal for meshes of the same points
    Column("reused_from", String(40)),
    Column("kept_from", Float),  # the start of its retention, if not its finish: for meshes of release 0.1
    Column("request_id", _Id(64)),
    Column("trace", String(64)),  # the traceparent of the request (W3C Trace Context)
    Column("spec_size", Integer, nullable=False, server_default="0"),  # bytes of the spec
    # With all columns that queries of waiting meshes read, since rows with samples in their spec are long.
    Index("meshes_by_status", "status", "key_id", "number", "n_xi", "n_eta"),
    # The meshes of a key in the order of lists; the sum of its specs needs only this index.
    Index("meshes_by_key", "key_id", "created_at", "id", "spec_size"),
    Index("meshes_by_fingerprint", "fingerprint", "key_id", "number"),
    Index("meshes_by_finish", "finished_at"),
    sqlite_autoincrement=True,
)

# The events of meshes; rows are only added. `number` runs 1, 2, 3, … for each mesh.
events = Table(
    "events",
    metadata,
    Column("mesh_id", _Id(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    Column("number", _Number, nullable=False),
    Column("time", Float, nullable=False),
    Column("kind", String(16), nullable=False),
    Column("data", JSON, nullable=False),
    PrimaryKeyConstraint("mesh_id", "number"),
)

# Files that belong to a mesh, by name: "mesh", "file:vtu:quad", "quality", "plot:mesh:svg", …
artifacts = Table(
    "artifacts",
    metadata,
    Column("mesh_id", _Id(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    Column("name", String(64), nullable=False),
    Column("sha256", String(64), nullable=False, index=True),
    Column("size", _Number, nullable=False),
    PrimaryKeyConstraint("mesh_id", "name"),
)

# Uploaded samples; the id is part of the SHA-256 of their canonical npz file.
samples = Table(
    "samples",
    metadata,
    Column("id", _Id(80), primary_key=True),
    Column("sha256", String(64), nullable=False, index=True),
    Column("size", _Number, nullable=False),
    Column("summary", JSON, nullable=False),
    Column("created_at", Float, nullable=False),
    Column("used_at", Float, nullable=False, server_default="0"),  # when a mesh with them was last requested
)

# The owners of samples: an equal upload of two keys is stored once, and belongs to both.
samples_keys = Table(
    "samples_keys",
    metadata,
    Column("samples_id", _Id(80), ForeignKey("samples.id", ondelete="CASCADE"), nullable=False),
    Column("key_id", _Id(40), nullable=False),
    Column("created_at", Float, nullable=False),
    PrimaryKeyConstraint("samples_id", "key_id"),
    Index("samples_by_key", "key_id"),
)

# The samples that meshes use.
mesh_samples = Table(
    "mesh_samples",
    metadata,
    Column("mesh_id", _Id(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False),
    Column("samples_id", _Id(80), nullable=False, index=True),
    PrimaryKeyConstraint("mesh_id", "samples_id"),
)

# Idempotency keys of requests, separate for each API key.
idempotency = Table(
    "idempotency",
    metadata,
    Column("key_id", _Id(40), nullable=False, server_default=""),
    Column("key", String(255), nullable=False),
    Column("fingerprint", String(64), nullable=False),
    # With an index, or each mesh that is deleted would look through all keys.
    Column("mesh_id", _Id(40), ForeignKey("meshes.id", ondelete="CASCADE"), nullable=False, index=True),
    PrimaryKeyConstraint("key_id", "key"),
)

# Sequences: each step is a mesh; the last `keep` of them are kept.
sequences = Table(
    "sequences",
    metadata,
    Column("id", _Id(40), primary_key=True),
    Column("key_id", _Id(40), nullable=False, server_default=""),
    Column("keep", Integer, nullable=False),
    Column("created_at", Float, nullable=False),
    Column("used_at", Float, nullable=False),
    Index("sequences_by_key", "key_id", "created_at", "id"),  # in the order of lists
)

# Steps of sequences: the SHA-256 of the mesh file that a step starts from, and of the file of its fields. `settings`
# say how the mesh moves, and what is known of the mesh before.
steps = Table(
    "steps",
    metadata,
    Column("mesh_id", _Id(40), ForeignKey("meshes.id", ondelete="CASCADE"), primary_key=True),
    Column("sequence_id", _Id(40), ForeignKey("sequences.id", ondelete="CASCADE"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("start", String(64)),
    Column("fields", String(64)),
    Column("settings", JSON(none_as_null=True)),
    Index("steps_by_sequence", "sequence_id", "number", unique=True),
)

# Meshes, samples and sequences that have expired: they answer 410, not 404.
retired = Table(
    "retired",
    metadata,
    Column("id", _Id(80), nullable=False),
    Column("key_id", _Id(40), nullable=False),
    Column("retired_at", Float, nullable=False),
    PrimaryKeyConstraint("id", "key_id"),
    Index("retired_by_time", "retired_at"),
)

# Files that are about to be removed, or were. A transaction that names the same content again looks here whether the
# file may be gone.
removals = Table(
    "removals",
    metadata,
    Column("sha256", String(64), nullable=False),
    Column("noted_at", Float, nullable=False),
    PrimaryKeyConstraint("sha256", "noted_at"),
)

# Small files, under the SHA-256 of their bytes; larger ones are in a folder or a bucket.
blobs = Table(
    "blobs",
    metadata,
    Column("sha256", String(64), primary_key=True),
    Column("size", _Number, nullable=False),
    Column("created_at", Float, nullable=False),
    Column("content", LargeBinary, nullable=False),  # the last: other columns are read without it
)

# API keys. `sha256` is the hash of the secret, which is not stored. `share` is the weight of the key's turns.
keys = Table(
    "keys",
    metadata,
    Column("id", _Id(40), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("sha256", String(64), nullable=False, unique=True),
    Column("scopes", JSON, nullable=False),
    Column("created_at", Float, nullable=False),
    Column("revoked_at", Float),
    Column("share", Integer, nullable=False, server_default="1"),
)
