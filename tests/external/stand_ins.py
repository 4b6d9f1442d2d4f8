"""Stand-ins for the base images of the compose file, made of Debian's packages, in a storage of their own.

No registry is needed. What runs in them is Debian's Python, PostgreSQL and Prometheus, not the official images; the
names and users are those of the official images, and so is what their entry points do as far as the compose file needs.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

MIRROR = "http://deb.debian.org/debian"
POLICY = "#!/bin/sh\nexit 101\n"  # no package starts a service while it is installed
# What PostgreSQL's image does at its start, as far as the compose file and docs/how-to/deploy.md use it.
POSTGRES_START = """\
#!/bin/sh
set -eu
PATH=$(echo /usr/lib/postgresql/*/bin):$PATH
export PATH PGDATA=/var/lib/postgresql/data
if [ ! -s "$PGDATA/PG_VERSION" ]; then
    printf '%s' "$POSTGRES_PASSWORD" > /tmp/password
    initdb --username="$POSTGRES_USER" --pwfile=/tmp/password $POSTGRES_INITDB_ARGS
    rm /tmp/password
    printf "\\nhost all all all scram-sha-256\\n" >> "$PGDATA/pg_hba.conf"
    printf "\\nlisten_addresses = '*'\\n" >> "$PGDATA/postgresql.conf"
    pg_ctl start -w -o "-c listen_addresses=''"
    createdb --username "$POSTGRES_USER" "$POSTGRES_DB"
    for script in /docker-entrypoint-initdb.d/*; do
        if [ -x "$script" ]; then "$script"; elif [ -f "$script" ]; then . "$script"; fi
    done
    pg_ctl stop -w -m fast
fi
exec postgres
"""


@dataclass(frozen=True, kw_only=True)
class StandIn:
    """A root folder of Debian: its release, its packages, what is done to it, and how the image is configured."""

    image: str
    suite: str
    packages: tuple[str, ...]
    finish: Callable[[Path], None]
    changes: tuple[str, ...] = ()


def make(stand_in: StandIn, folder: Path, run: Callable[..., str]) -> None:
    """Make the image in the storage of ``run``, unless it is there. Takes about two minutes."""
    if stand_in.image in run("podman", "images", "--format", "{{.Repository}}:{{.Tag}}").split():
        return
    root = folder / stand_in.suite
    if not (root / "done").exists():
        shutil.rmtree(root, ignore_errors=True)
        run("debootstrap", "--variant=minbase", stand_in.suite, str(root), MIRROR)
        (root / "usr/sbin/policy-rc.d").write_text(POLICY)
        (root / "usr/sbin/policy-rc.d").chmod(0o755)
        (root / "done").touch()
    here = folder / "root"
    shutil.rmtree(here, ignore_errors=True)
    run("cp", "--archive", str(root), str(here))
    run("mount", "--bind", "/proc", str(here / "proc"))
    try:
        inside = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for words in (("update", "-qq"), ("install", "-y", "-qq", "--no-install-recommends", *stand_in.packages)):
            run("chroot", str(here), "apt-get", *words, env=inside)
        run("chroot", str(here), "apt-get", "clean")
        stand_in.finish(here)
    finally:
        run("umount", str(here / "proc"))
    changes = [word for change in stand_in.changes for word in ("--change", change)]
    with subprocess.Popen(["tar", "-C", str(here), "-c", "."], stdout=subprocess.PIPE) as archive:
        run("podman", "import", *changes, "-", stand_in.image, stdin=archive.stdout)
    shutil.rmtree(here)


def _python(root: Path) -> None:
    for name in ("python", "python3"):
        (root / "usr/local/bin" / name).symlink_to("/usr/bin/python3")


def _postgres(root: Path) -> None:
    start = root / "usr/local/bin/docker-entrypoint.sh"
    start.write_text(textwrap.dedent(POSTGRES_START))
    start.chmod(0o755)
    (root / "docker-entrypoint-initdb.d").mkdir()
    shutil.rmtree(root / "var/lib/postgresql")
    data = root / "var/lib/postgresql/data"
    data.mkdir(parents=True)
    subprocess.run(["chroot", str(root), "chown", "-R", "postgres:postgres", "/var/lib/postgresql"], check=True)
    data.chmod(0o700)
    for program in (root / "usr/lib/postgresql").glob("*/bin/*"):
        link = root / "usr/local/bin" / program.name
        link.symlink_to("/" + str(program.relative_to(root)))


def _prometheus(root: Path) -> None:
    (root / "bin/prometheus").exists() or (root / "bin/prometheus").symlink_to("/usr/bin/prometheus")
    data = root / "prometheus"
    data.mkdir()
    os.chown(data, 65534, 65534)


PYTHON = StandIn(
    image="docker.io/library/python:3.11-slim",
    suite="bookworm",
    packages=("python3", "python3-venv", "python3-pip", "ca-certificates"),
    finish=_python,
    changes=("CMD python3",),
)
POSTGRES = StandIn(
    image="docker.io/library/postgres:17.6",
    suite="trixie",
    packages=("postgresql",),
    finish=_postgres,
    changes=('ENTRYPOINT ["docker-entrypoint.sh"]', "ENV PGDATA=/var/lib/postgresql/data", "ENV LANG=C.UTF-8"),
)
PROMETHEUS = StandIn(
    image="docker.io/prom/prometheus:v3.5.0",
    suite="trixie",
    packages=("prometheus", "wget"),
    finish=_prometheus,
    changes=('ENTRYPOINT ["/usr/bin/prometheus"]',),
)
