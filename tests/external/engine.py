"""Podman as the docker of the documentation: its settings, its storage, and a `docker` that translates."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from external import stand_ins

ROOT = Path(__file__).parents[2]
# Where roots, images and containers are kept between runs; about 6 GB.
FOLDER = Path(os.environ.get("EQUIMESH_TEST_CONTAINERS", "/var/tmp/equimesh-containers"))
_ELSEWHERE = (Path(sys.executable).parent, Path("/usr/lib/podman"), Path("/usr/sbin"), Path("/sbin"))
CONTAINERS = """\
[containers]
default_ulimits = ["nofile=4096:4096", "nproc=4096:4096"]
[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
[network]
network_backend = "netavark"
"""
STORAGE = """\
[storage]
driver = "overlay"
graphroot = "{folder}/storage"
runroot = "{folder}/run"
"""
# Podman 4.3 builds in a root of its own, with this machine's network and certificates, and keeps HEALTHCHECK.
BUILD = "--isolation=chroot --network=host --format=docker --volume=/etc/ssl/certs:/etc/ssl/certs:ro" + (
    " --env=PIP_CERT=/etc/ssl/certs/ca-certificates.crt"
)
DOCKER = """\
#!{python}
# `docker` of the documentation, by Podman.
import os, subprocess, sys, time
words = sys.argv[1:]
if words[:1] == ["compose"]:
    words = ["-T" if word == "--no-TTY" else word for word in words[1:]]
    for number, word in enumerate(words):
        if word in ("run", "exec") and "-T" not in words:  # docker finds out whether there is a terminal
            words.insert(number + 1, "-T")
            break
    if words[:1] == ["run"]:  # podman-compose does not wait for `service_healthy` with a Podman before 4.6
        subprocess.run(["podman-compose", "up", "--detach", "database"], stdout=sys.stderr)
        check = ["podman", "healthcheck", "run", os.path.basename(os.getcwd()) + "_database_1"]
        for _ in range(120):
            if subprocess.run(check, stdout=subprocess.DEVNULL).returncode == 0:
                break
            time.sleep(1.0)
    os.execvp("podman-compose", ["podman-compose", "--podman-build-args={build}", *words])
if words[:1] == ["build"]:
    words[1:1] = "{build}".split()
if words[:1] == ["pull"] and subprocess.run(["podman", "image", "exists", words[-1]]).returncode == 0:
    sys.exit()  # a stand-in
os.execvp("podman", ["podman", *words])
"""


@dataclass(frozen=True)
class Engine:
    """Runs commands of the documentation in a folder of its own, against the storage in ``folder``."""

    folder: Path

    @cached_property
    def environment(self) -> dict[str, str]:
        """The variables with which a shell finds `docker` and the storage; none of equimesh's or of compose's."""
        names = ("EQUIMESH_", "COMPOSE_", "POSTGRES_", "PG")
        plain = {name: value for name, value in os.environ.items() if not name.startswith(names)}
        return {
            **plain,
            "PATH": os.pathsep.join([str(self.folder / "bin"), *map(str, _ELSEWHERE), plain["PATH"]]),
            "CONTAINERS_CONF": str(self.folder / "containers.conf"),
            "CONTAINERS_STORAGE_CONF": str(self.folder / "storage.conf"),
        }

    def prepare(self) -> None:
        """Write the settings and `docker`, and make the stand-ins that are not there yet."""
        (self.folder / "bin").mkdir(parents=True, exist_ok=True)
        (self.folder / "containers.conf").write_text(CONTAINERS)
        (self.folder / "storage.conf").write_text(STORAGE.format(folder=self.folder))
        docker = self.folder / "bin" / "docker"
        docker.write_text(DOCKER.format(python=sys.executable, build=BUILD))
        docker.chmod(0o755)
        for stand_in in (stand_ins.PYTHON, stand_ins.POSTGRES, stand_ins.PROMETHEUS):
            stand_ins.make(stand_in, self.folder, self.run)

    def run(self, *words: str, code: int | None = 0, **options: Any) -> str:
        """The output of a command that has to end with ``code``."""
        options = {"env": self.environment, "timeout": 1800, **options}
        done = subprocess.run(words, capture_output=True, text=True, **options)
        assert code is None or done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return str(done.stdout)

    def shell(self, commands: str, folder: Path) -> str:
        """The output of lines of the documentation, in a folder; they are printed."""
        print(f"\n$ {commands.strip()}", flush=True)
        said = self.run("bash", "-euo", "pipefail", "-c", commands, cwd=folder)
        print(said, flush=True)
        return said

    def inspect(self, name: str) -> dict[str, Any]:
        """What Podman knows of a container."""
        (found,) = json.loads(self.run("podman", "container", "inspect", name))
        return dict(found)

    @contextmanager
    def checking_health(self) -> Iterator[None]:
        """Run the health checks of all containers again and again, as systemd does for Podman where it runs."""
        stop = threading.Event()

        def check() -> None:
            while not stop.wait(2.0):
                for name in self.run("podman", "ps", "--format", "{{.Names}}", code=None).split():
                    self.run("podman", "healthcheck", "run", name, code=None)

        thread = threading.Thread(target=check)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def documented(page: str, mark: str) -> str:
    """The commands of a page under a mark; ``<!-- containers: start -->`` marks "start"."""
    text = (ROOT / "docs" / "how-to" / page).read_text()
    (code,) = re.findall(rf"<!-- containers: {mark} -->\n```shell\n(.*?)```", text, re.DOTALL)
    return str(code)
