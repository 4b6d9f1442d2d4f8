"""The settings of a service: one frozen record, read from ``EQUIMESH_…`` environment variables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from equimesh.workers import available

MIB = 1024 * 1024


class Settings(BaseSettings):
    """Everything an operator can choose; ``EQUIMESH_PORT=9000`` sets ``port``, and so on."""

    model_config = SettingsConfigDict(env_prefix="EQUIMESH_", frozen=True, extra="forbid")

    host: str = Field("127.0.0.1", description="Address to listen on; 0.0.0.0 for every interface.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    data_dir: Path = Field(Path("equimesh-data"), description="Folder of the database and of all files.")
    workers: int = Field(
        default_factory=lambda: max(1, os.cpu_count() or 1),
        ge=1,
        le=256,
        description="Worker processes that solve; by default one for each processor.",
    )
    threads: int = Field(
        0, ge=0, le=64, description="Threads of one worker; 0: the processors shared out among the workers."
    )
    time_limit: float = Field(300.0, gt=0, description="Seconds that one mesh may take before it fails.")
    memory_limit: int = Field(
        4096, ge=16, description="MiB that one worker may allocate on top of what it needs to start."
    )
    max_points: int = Field(300_000, ge=16, description="Most points n_xi * n_eta of a mesh.")
    max_body: int = Field(64 * MIB, ge=1024, description="Most bytes of a request body.")
    max_samples: int = Field(1_000_000, ge=4, description="Most samples of a monitor function.")
    max_subdomains: int = Field(256, ge=1, description="Most subdomains of one mesh.")
    max_iterations: int = Field(1000, ge=1, description="Most Schwarz iterations that a spec may ask for.")
    max_queue: int = Field(10_000, ge=1, description="Most waiting meshes; beyond it a request gets 429.")
    max_wait: float = Field(30.0, ge=0, description="Longest wait, in seconds, of one request for a mesh.")
    max_attempts: int = Field(3, ge=1, description="Times a mesh is tried when its worker is lost.")
    lease: float = Field(15.0, gt=0, description="Seconds after which a silent service loses its meshes.")
    poll: float = Field(0.2, gt=0, le=5, description="Seconds between looks at the store for progress.")
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="Least level logged.")

    @property
    def worker_threads(self) -> int:
        """Threads of one worker, at least 1."""
        return self.threads or min(64, max(1, available() // self.workers))

    @property
    def database_url(self) -> str:
        """The address of the database, as SQLAlchemy takes it."""
        return f"sqlite:///{self.data_dir / 'equimesh.sqlite3'}"
