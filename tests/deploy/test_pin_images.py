"""The digests of base images are written where compose reads them."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_images_can_be_pinned_by_digest(tmp_path: Path) -> None:
    docker = tmp_path / "docker"
    docker.write_text('#!/bin/sh\n[ "$1" = pull ] || { for last; do :; done; echo "${last%%:*}@sha256:0123"; }\n')
    docker.chmod(0o755)
    path = os.pathsep.join([str(tmp_path), os.environ["PATH"]])
    done = subprocess.run([ROOT / "deploy/pin-images"], env={"PATH": path}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.split()) == [
        "GRAFANA_IMAGE=grafana/grafana@sha256:0123",
        "POSTGRES_IMAGE=postgres@sha256:0123",
        "PROMETHEUS_IMAGE=prom/prometheus@sha256:0123",
        "PYTHON_IMAGE=python@sha256:0123",
    ]
