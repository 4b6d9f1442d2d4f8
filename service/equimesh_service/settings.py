"""The settings of a service: one frozen record, read from ``EQUIMESH_…`` environment variables."""

import os
import re
from collections.abc import Mapping
from difflib import get_close_matches
from ipaddress import ip_network
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

MIB = 1024 * 1024
# A name, an address of version 4, or one of version 6, which may be in brackets.
_HOST = re.compile(r"[A-Za-z0-9_.-]+|\[?[0-9a-fA-F:.]*:[0-9a-fA-F:.]*:[0-9a-fA-F:.]*\]?")
# Workers for files, pictures and samples, so that these never wait for solves.
FILE_WORKERS = 2
# Memory of the service itself, with all its workers at rest.
SERVICE_MIB = 1024


class Settings(BaseSettings):
    """All settings of an operator; ``EQUIMESH_PORT=9000`` sets ``port``, and so on."""

    model_config = SettingsConfigDict(env_prefix="EQUIMESH_", frozen=True, extra="forbid")

    host: str = Field("127.0.0.1", description="Address to listen on; 0.0.0.0 for every interface.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    root_path: str = Field(
        "",
        pattern=r"^(/[A-Za-z0-9._~-]+)*/?$",
        description="Path under which a proxy serves this service, e.g. /meshes.",
    )
    trusted_proxies: str = Field(
        "127.0.0.1",
        description="Addresses and networks of proxies whose X-Forwarded headers are trusted, separated by commas.",
    )
    allowed_hosts: str = Field(
        "",
        description="Names by which a service without API keys is reached, apart from localhost and its own address, "
        "separated by commas; *: any.",
    )

    engine: Literal["processes", "dask"] = Field(
        "processes", description="Where meshes are solved: processes, on this machine; dask, on a cluster."
    )
    scheduler: str = Field(
        "",
        description="Address of the scheduler of the cluster, tcp://host:8786 or tls://host:8786; for the engine dask.",
    )
    workers: int = Field(
        default_factory=lambda: max(1, os.cpu_count() or 1),
        ge=1,
        le=256,
        description="Worker processes that solve; by default one for each processor. Two more make files and pictures, "
        "and read samples.",
    )
    threads: int = Field(
        0,
        ge=0,
        le=64,
        description="Threads of one worker on large grids; 0: the processors shared by the workers, on a cluster 1.",
    )
    warm_up: Literal["all", "none"] = Field(
        "all",
        description="What a worker does before its first mesh: all, load every numerical loop, or "
        "compile those of the most frequent problems, and the rest in a process of low priority; none, nothing: the "
        "service starts sooner, and first meshes take longer.",
    )
    time_limit: float = Field(300.0, gt=0, description="Seconds that one mesh may take before it fails.")
    preview_seconds: float = Field(10.0, gt=0, description="Seconds that one preview may take before it is stopped.")
    memory_limit: int = Field(
        4096,
        ge=16,
        description="MiB that one worker may allocate on top of what it needs to start; then the mesh fails.",
    )
    max_attempts: int = Field(3, ge=1, description="Attempts at a mesh whose workers are lost.")
    lease: float = Field(15.0, gt=0, description="Seconds after which a silent service loses its meshes.")
    poll: float = Field(0.2, gt=0, le=5, description="Seconds between queries of the store for progress.")
    reuse: bool = Field(True, description="Answer with a finished mesh of the same spec, samples and version.")

    max_points: int = Field(300_000, ge=16, description="Most points n_xi * n_eta of a mesh that one machine computes.")
    max_preview_points: int = Field(70_000, ge=16, description="Most points n_xi * n_eta of a preview.")
    max_cluster_points: int = Field(
        300_000_000,
        ge=0,
        description="Most points of a mesh that a cluster computes in parts, with the engine dask; 0: no such meshes.",
    )
    max_body: int = Field(64 * MIB, ge=1024, description="Most bytes of a request body.")
    max_samples: int = Field(1_000_000, ge=4, description="Most samples of a monitor function.")
    max_subdomains: int = Field(256, ge=1, description="Most subdomains of one mesh.")
    max_iterations: int = Field(1000, ge=1, description="Most Schwarz iterations of a spec.")
    max_queue: int = Field(
        10_000, ge=1, description="Most waiting meshes; beyond it a request gets 429 with Retry-After."
    )
    max_wait: float = Field(30.0, ge=0, description="Longest wait, in seconds, of one request (Prefer: wait, ?wait=).")

    data_dir: Path = Field(
        Path("equimesh-data"), description="Folder of the database and of all files; one service for each folder."
    )
    database_url: SecretStr = Field(
        SecretStr(""),
        description="Database as SQLAlchemy takes it, e.g. postgresql+psycopg://user:password@host/name; "
        "empty: SQLite in the data folder. Give it as a variable: other users of the machine can read options.",
    )
    files_url: str = Field(
        "",
        description="Where files of more than 1 MiB are kept: s3://bucket/prefix, or file:///folder on a disk that "
        "services share; empty: the folder files in the data folder.",
    )
    s3_endpoint: str = Field("", description="Address of an S3-compatible storage; empty: that of AWS.")
    s3_region: str = Field("us-east-1", description="Region of the S3 storage.")
    s3_access_key: SecretStr = Field(SecretStr(""), description="Access key of the S3 storage.")
    s3_secret_key: SecretStr = Field(SecretStr(""), description="Secret key of the S3 storage; a variable, too.")
    retention_days: float = Field(
        30.0, ge=0, description="Days that a finished mesh and unused samples are kept; 0: until they are deleted."
    )

    allow_anonymous: bool = Field(False, description="Serve other machines although no API key exists.")
    key_max_queued: int = Field(1000, ge=0, description="Most unfinished meshes of one key; 0: no limit.")
    key_max_points: int = Field(50_000_000, ge=0, description="Most points of a key's unfinished meshes; 0: no limit.")
    key_max_bytes: int = Field(
        10_240 * MIB, ge=0, description="Most bytes of a key's stored files, samples and specs; 0: no limit."
    )
    key_requests_per_minute: int = Field(
        12_000, ge=0, description="Most requests of one key in a minute, for each service process; 0: no limit."
    )
    key_max_waits: int = Field(
        100,
        ge=0,
        description="Most waits and event streams that one key holds open, in each service process; 0: no limit.",
    )

    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info",
        description="Least level logged; info has a line for every request. Not set at a terminal: warning.",
    )
    log_format: Literal["text", "json"] = Field("text", description="Log lines for people, or as JSON objects.")
    metrics: bool = Field(True, description="Serve Prometheus metrics at /metrics.")
    trace_endpoint: str = Field(
        "", description="OTLP over HTTP address for OpenTelemetry traces, e.g. http://host:4318/v1/traces; empty: none."
    )

    @field_validator("engine", mode="before")
    @classmethod
    def _was_pebble(cls, value: object) -> object:
        """The name of the default up to release 0.2."""
        return "processes" if value == "pebble" else value

    @field_validator("trusted_proxies")
    @classmethod
    def _are_addresses(cls, value: str) -> str:
        # The server would take any other word for the name of a host.
        for part in _parts(value):
            if part != "*":
                ip_network(part)
        return value

    @field_validator("allowed_hosts")
    @classmethod
    def _are_hosts(cls, value: str) -> str:
        for part in _parts(value):
            if part != "*" and not _HOST.fullmatch(part):
                raise ValueError(
                    f"{part!r} is no host: give names and addresses without scheme, port and path, like "
                    "meshes.example.org or 192.168.0.7"
                )
        return value

    @model_validator(mode="after")
    def _has_its_scheduler(self) -> "Settings":
        if self.engine == "dask" and not self.scheduler:
            raise ValueError("the engine dask needs a scheduler: give its address, like tcp://host:8786")
        return self

    @property
    def allowed_host_names(self) -> list[str]:
        """The hosts in ``allowed_hosts``."""
        return _parts(self.allowed_hosts)

    @property
    def has_cluster(self) -> bool:
        """Whether meshes of more than ``max_points`` points are computed on a cluster, in parts."""
        return self.engine == "dask" and self.max_cluster_points > 0

    @property
    def worker_threads(self) -> int:
        """Threads of one worker, at least 1; on a cluster 1 unless they are set."""
        if self.engine == "dask":
            return self.threads or 1
        return self.threads or min(64, max(1, _processors() // self.workers))

    @property
    def own_workers(self) -> int:
        """Worker processes that solve on this machine; none with a cluster."""
        return 0 if self.engine == "dask" else self.workers

    @property
    def most_memory(self) -> int:
        """MiB that the service may hold with every worker at its limit: those that solve here, and those for files."""
        return (self.own_workers + FILE_WORKERS) * self.memory_limit + SERVICE_MIB

    @property
    def root(self) -> str:
        """The start of the paths of this service: the root path without a slash at its end."""
        return self.root_path.rstrip("/")

    @property
    def database(self) -> str:
        """The address of the database in use, as SQLAlchemy takes it."""
        return self.database_url.get_secret_value() or f"sqlite:///{self.data_dir.resolve() / 'equimesh.sqlite3'}"


# The groups of the settings, each with its first one: the others follow in the order of the fields.
_FIRST_OF_GROUPS = {
    "network": "host",
    "work": "engine",
    "limits": "max_points",
    "storage": "data_dir",
    "keys and quotas": "allow_anonymous",
    "logs and metrics": "log_level",
}
PREFIX = "EQUIMESH_"
# Variables that clients read: an address and an API key.
_CLIENT_VARIABLES = ("URL", "KEY", "QUIET", "CACHE_DIR")


def _parts(value: str) -> list[str]:
    """The parts of a list that is separated by commas."""
    return [part.strip() for part in value.split(",") if part.strip()]


def _processors() -> int:
    """Processors that this process may use. The solver has the same function, but importing it loads the solver."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def variable(name: str) -> str:
    """The environment variable of a setting."""
    return PREFIX + name.upper()


def groups() -> dict[str, list[str]]:
    """The names of all settings by what they are for, in the order of the fields."""
    titles = {first: title for title, first in _FIRST_OF_GROUPS.items()}
    found: dict[str, list[str]] = {}
    for name in Settings.model_fields:
        if name in titles:
            found[titles[name]] = []
        list(found.values())[-1].append(name)
    return found


def find_unknown(environment: Mapping[str, str]) -> dict[str, str | None]:
    """Every variable with the prefix of settings that is no setting, with the most similar setting's variable."""
    known = [*map(str.upper, Settings.model_fields), *_CLIENT_VARIABLES]
    found: dict[str, str | None] = {}
    for given in sorted(environment):
        name = given.upper()
        if name.startswith(PREFIX) and name.removeprefix(PREFIX) not in known:
            nearest = get_close_matches(name.removeprefix(PREFIX), known, n=1)
            found[given] = PREFIX + nearest[0] if nearest else None
    return found


def describe_unknown(given: str, nearest: str | None) -> str:
    """The warning about a variable that :func:`find_unknown` returns."""
    hint = f"; did you mean {nearest}?" if nearest else ""
    return f"{given} is no setting, and is ignored{hint}"
