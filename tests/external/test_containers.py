"""Containers, really run: what deploy.md, observe.md, back-up.md and upgrade.md say for compose, line by line.

``python -m pytest --everything -s tests/external/test_containers.py`` as root, with Podman in the place of Docker and
stand-ins for the base images. It takes about 20 minutes the first time; stand-ins and layers are kept in
``EQUIMESH_TEST_CONTAINERS``, /var/tmp/equimesh-containers if it is not set. The ports 8000, 8001 and 9090 must be free.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

import httpx
import pytest

from external import stand_ins
from external.engine import FOLDER, ROOT, Engine, documented

pytestmark = [pytest.mark.external, pytest.mark.everything, pytest.mark.needs("containers")]
# The last commit of release 0.2.0.
RELEASE_0_2 = "fb785637516e35961936ee1a2f7e2733bece17dd"
TEXTS = ("README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md")
FIRST, SECOND = "http://127.0.0.1:8000", "http://127.0.0.1:8001"
MOST_SECONDS = 300.0
# The image without its base: what is installed, and the compiled loops.
MAX_INSTALLED_MIB = 575


def until(met: Callable[[], bool], what: str) -> None:
    """Wait until it is so."""
    end = time.monotonic() + MOST_SECONDS
    while not met():
        assert time.monotonic() < end, f"{what}: not within {MOST_SECONDS:.0f} s"
        time.sleep(0.5)


def is_ready(url: str) -> bool:
    try:
        return httpx.get(f"{url}/readyz", timeout=10.0).status_code == 200
    except httpx.HTTPError:
        return False


@dataclass
class Project:
    """A folder with a compose file, as somebody has it who follows the page; its name is that of the project."""

    engine: Engine
    folder: Path
    key: str = ""

    def copy(self, *names: str) -> None:
        """Copy what the image is built from, and the compose file, as they are now."""
        for name in ("compose.yaml", "Dockerfile", ".dockerignore", "pyproject.toml", *TEXTS, *names):
            shutil.copy(ROOT / name, self.folder / name)
        for name in ("deploy", "solver", "client", "service", "docs", "examples"):
            shutil.rmtree(self.folder / name, ignore_errors=True)
            shutil.copytree(ROOT / name, self.folder / name, ignore=shutil.ignore_patterns("__pycache__"))

    def shell(self, commands: str) -> str:
        """The output of lines of the documentation, with the key and the day put in."""
        lines = commands.replace("EQUIMESH_KEY=em_...", f"EQUIMESH_KEY={self.key}")
        return self.engine.shell(lines.replace("2026-01-31", date.today().isoformat()), self.folder)

    def page(self, page: str, mark: str) -> str:
        """The output of the lines of a page under a mark."""
        return self.shell(documented(page, mark))

    def container(self, service: str) -> str:
        """The name of the container of a service."""
        return f"{self.folder.name}_{service}_1"

    def start(self) -> None:
        """Follow the page to a service that is ready, and keep the secret of its first key."""
        said = self.page("deploy.md", "start")
        self.key = re.findall(r"^em_\S+", said, re.MULTILINE)[0]
        until(lambda: is_ready(FIRST), "the service is ready")

    def client(self, url: str = FIRST) -> httpx.Client:
        return httpx.Client(base_url=url, headers={"Authorization": f"Bearer {self.key}"}, timeout=60.0)

    def crash(self, service: str, number: int = 1) -> None:
        """Kill the first process of a container from outside, as a crash does; start it if the engine does not."""
        name = f"{self.container(service).removesuffix('1')}{number}"
        os.kill(self.engine.inspect(name)["State"]["Pid"], signal.SIGKILL)
        time.sleep(5.0)
        if not self.engine.inspect(name)["State"]["Running"]:
            print(f"{name}: started by hand, since Podman did not within 5 s", flush=True)
            self.engine.run("podman", "start", name)

    def down(self) -> None:
        """Remove containers, networks and volumes."""
        profiles = [word for name in ("replica", "monitoring", "cluster") for word in ("--profile", name)]
        everything = ("docker", "compose", *profiles, "down", "--volumes")
        self.engine.run(*everything, cwd=self.folder, code=None)
        label = f"label=io.podman.compose.project={self.folder.name}"
        left = self.engine.run("podman", "ps", "--all", "--quiet", "--filter", label).split()
        if left:  # podman-compose does not know of the workers from --scale
            self.engine.run("podman", "rm", "--force", *left)
            self.engine.run(*everything, cwd=self.folder, code=None)


def mesh(number: float) -> dict[str, Any]:
    u = {"expression": f"tanh(20*(x - y*y - {number}))"}
    return {"monitor": {"kind": "arc_length", "u": u}, "grid": {"n_xi": 65, "n_eta": 65}}


@dataclass
class Load:
    """Requests for meshes, one after the other, at all services in turn; whatever was accepted is kept."""

    project: Project
    services: tuple[str, ...] = (FIRST, SECOND)
    accepted: list[str] = field(default_factory=list)
    refused: int = 0
    _stop: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Load:
        self._thread = threading.Thread(target=self._ask)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _ask(self) -> None:
        number = 0
        while not self._stop.wait(0.1):
            number += 1
            try:
                with self.project.client(self.services[number % len(self.services)]) as http:
                    answer = http.post("/v1/meshes", json=mesh(number / 1000), timeout=10.0)
            except httpx.HTTPError:
                self.refused += 1
                continue
            if answer.status_code in (200, 201, 202):
                self.accepted.append(answer.json()["id"])
            else:
                self.refused += 1


def check_all_succeed(project: Project, ids: list[str]) -> None:
    """Every mesh that was accepted ends with success."""
    with project.client() as http:
        for mesh_id in ids:

            def status(mesh_id: str = mesh_id) -> str:
                return str(http.get(f"/v1/meshes/{mesh_id}").json().get("status"))

            until(lambda: status() not in ("queued", "running"), f"mesh {mesh_id} ends")
            assert status() == "succeeded", http.get(f"/v1/meshes/{mesh_id}").text


def files_of(project: Project, ids: list[str]) -> dict[str, bytes]:
    """The files of meshes."""
    with project.client() as http:
        return {mesh_id: http.get(f"/v1/meshes/{mesh_id}/file", params={"format": "npz"}).content for mesh_id in ids}


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    engine = Engine(FOLDER)
    engine.prepare()
    with engine.checking_health():
        yield engine


@pytest.fixture(scope="module")
def project(engine: Engine) -> Iterator[Project]:
    """A service that was started as the page says."""
    folder = FOLDER / "equimesh"
    folder.mkdir(exist_ok=True)
    project = Project(engine, folder)
    project.down()
    project.copy("constraints.txt")
    try:
        project.start()
        yield project
    finally:
        project.down()


def test_the_documented_lines_start_a_service(project: Project) -> None:
    said = project.page("deploy.md", "check")
    assert "5 checks: 0 failed" in said or "4 checks: 0 failed" in said, said
    doctor = project.shell("docker compose exec equimesh equimesh doctor --stored")
    assert "0 failed" in doctor
    assert re.search(r"^ok +memory +2 workers that solve and 2 for files may take 2048 MiB each", doctor, re.MULTILINE)


def check_confined(project: Project, service: str) -> None:
    """The container of a service has a read-only root, no root user, no capabilities, and limits."""
    found = project.engine.inspect(project.container(service))
    assert found["HostConfig"]["ReadonlyRootfs"], service
    assert found["HostConfig"]["Memory"] > 0, service
    assert 0 < found["HostConfig"]["PidsLimit"] <= 1024, service
    status = Path(f"/proc/{found['State']['Pid']}/status").read_text()
    assert re.search(r"^Uid:\s+[1-9]", status, re.MULTILINE), service
    assert re.search(r"^CapEff:\s+0+$", status, re.MULTILINE), service
    assert re.search(r"^NoNewPrivs:\s+1$", status, re.MULTILINE), service


def test_every_container_is_confined(project: Project) -> None:
    for service in ("equimesh", "database"):
        check_confined(project, service)
    role = "SELECT rolsuper OR rolcreatedb OR rolcreaterole FROM pg_roles WHERE rolname = current_user"
    line = f'docker compose exec database psql --username equimesh --dbname equimesh -Atc "{role}"'
    assert project.shell(line).split() == ["f"]
    write = (
        'docker compose exec database psql --username equimesh --dbname equimesh -Atc "CREATE TABLE public.x (y int)"'
    )
    assert "permission denied" in project.shell(f"{write} 2>&1 || true")


def test_what_is_in_the_image(project: Project) -> None:
    root = project.engine.run("podman", "image", "mount", "localhost/equimesh:0.3.0").strip()
    try:
        largest = "du -sm opt; du -sm opt/equimesh/lib/python3*/site-packages/* | sort -rn | head -16"
        said = project.engine.run("sh", "-c", largest, cwd=root)
        print(said)
        assert int(said.split()[0]) < MAX_INSTALLED_MIB
        names = {path.name for path in Path(root, "opt/equimesh/lib").glob("python3*/site-packages/*")}
        assert not names & {"pip", "setuptools", "hatchling", "fontTools"}
    finally:
        project.engine.run("podman", "image", "umount", "localhost/equimesh:0.3.0")


def test_compiled_loops_are_those_of_the_image(project: Project) -> None:
    """All loops come from the archive of the image, and nothing is compiled again."""
    with project.client() as http:
        for spec in (mesh(0.5), {"monitor": {"u": "tanh(20*(x - y))"}, "grid": {"n_xi": 33, "n_eta": 33}}):
            made = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"})
            assert made.json()["status"] == "succeeded"
    assert project.shell("docker compose exec equimesh sh -c 'ls /data/loops/*/ | wc -l'").strip() == "0"


def places(project: Project) -> int:
    """How many meshes the service may solve at the same time, as it says itself; 0 when it does not answer."""
    try:
        with project.client() as http:
            found = re.search(r'^equimesh_workers\{pool="solve"\} (\d+)', http.get("/metrics").text, re.MULTILINE)
    except httpx.HTTPError:
        return 0
    return int(found[1]) if found else 0


def test_no_accepted_mesh_is_lost_while_containers_of_a_cluster_are_killed(project: Project) -> None:
    settings = project.folder / ".env"
    before = settings.read_text()
    try:
        project.page("deploy.md", "cluster")
        until(lambda: is_ready(FIRST) and places(project) == 4, "two workers of two processes have joined")
        for service in ("scheduler", "worker"):
            check_confined(project, service)
        with Load(project, services=(FIRST,)) as load:
            for service, number in (("worker", 2), ("scheduler", 1), ("equimesh", 1), ("worker", 1)):
                until(lambda: is_ready(FIRST) and places(project) == 4, "the cluster is whole")
                count = len(load.accepted)
                until(lambda count=count: len(load.accepted) > count + 10, "meshes are requested")  # type: ignore[misc]
                project.crash(service, number)
            until(lambda: is_ready(FIRST) and places(project) == 4, "the cluster is whole again")
        print(f"{len(load.accepted)} meshes were accepted, {load.refused} requests failed")
        check_all_succeed(project, load.accepted)
        doctor = project.shell("docker compose exec equimesh equimesh doctor")
        assert "2 workers solve 4 meshes at the same time" in doctor
    finally:
        settings.write_text(before)
        # podman-compose would stop the first worker only.
        for name in ("worker_2", "worker_1", "scheduler_1"):
            project.engine.run("podman", "rm", "--force", f"{project.folder.name}_{name}", code=None)
        project.shell("docker compose up --detach")
        until(lambda: is_ready(FIRST), "the service solves by itself again")


def test_a_backup_is_restored(project: Project) -> None:
    with project.client() as http:
        page = http.get("/v1/meshes", params={"limit": 5}).json()
    ids = [row["id"] for row in page["meshes" if "meshes" in page else "items"]]
    before = files_of(project, ids)
    project.page("back-up.md", "back up")
    with project.client() as http:
        for mesh_id in ids:
            assert http.delete(f"/v1/meshes/{mesh_id}").status_code == 204
    said = project.page("back-up.md", "restore")
    assert re.search(r"^ok +stored +all \d+ files in the database exist$", said, re.MULTILINE)
    until(lambda: is_ready(FIRST), "the service is ready")
    assert files_of(project, ids) == before


def test_prometheus_sees_every_service(project: Project) -> None:
    project.shell("docker compose --profile replica up --detach")
    # Grafana is not among Debian's packages: the line of the page, without it.
    project.shell(documented("observe.md", "monitoring").replace("up --detach", "up --detach prometheus"))
    project.page("observe.md", "metrics key")

    def targets() -> list[Any]:
        try:
            query = {"query": 'up{job="equimesh"} == 1'}
            return list(httpx.get("http://127.0.0.1:9090/api/v1/query", params=query).json()["data"]["result"])
        except httpx.HTTPError:
            return []

    until(lambda: len(targets()) == 2, "Prometheus sees both")
    found = project.engine.inspect(project.container("prometheus"))
    assert found["HostConfig"]["ReadonlyRootfs"]
    assert re.search(r"^Uid:\s+65534", Path(f"/proc/{found['State']['Pid']}/status").read_text(), re.MULTILINE)


def test_images_are_pinned_by_their_digests(project: Project) -> None:
    said = project.engine.run("sh", "-c", "deploy/pin-images || true", cwd=project.folder)
    for stand_in in (stand_ins.PYTHON, stand_ins.POSTGRES, stand_ins.PROMETHEUS):
        name = stand_in.image.removeprefix("docker.io/").removeprefix("library/").partition(":")[0]
        assert re.search(rf"^[A-Z]+_IMAGE=\S*{name}@sha256:[0-9a-f]{{64}}$", said, re.MULTILINE), said


def test_the_image_alone_serves_this_machine(project: Project) -> None:
    project.down()
    name = project.page("deploy.md", "alone").split()[-1]
    try:
        until(lambda: is_ready(FIRST), "the container is ready")
        made = httpx.post(f"{FIRST}/v1/meshes", json=mesh(0.1), headers={"Prefer": "wait=300"}, timeout=60.0)
        assert made.json()["status"] == "succeeded"
    finally:
        project.engine.run("podman", "rm", "--force", "--volumes", name)
        project.engine.run("podman", "volume", "rm", "--force", "equimesh", code=None)


def test_release_0_2_is_upgraded(engine: Engine, project: Project) -> None:
    project.down()
    folder = FOLDER / "upgraded"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", RELEASE_0_2], capture_output=True)
    if archive.returncode:
        pytest.skip("the sources of release 0.2.0 are not here: this is no clone with its history")
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    file = folder / "compose.yaml"
    # Podman gives this folder to root; a volume has the owner of the image.
    old = file.read_text().replace("tmpfs: [/tmp, /var/run/postgresql]", "tmpfs: [/tmp]")
    old = old.replace("- database:/var", "- sockets:/run/postgresql\n      - database:/var")
    file.write_text(old.replace("volumes:\n  data:", "volumes:\n  sockets:\n  data:"))
    upgraded = Project(engine, folder)
    upgraded.down()
    try:
        upgraded.start()
        with upgraded.client() as http:
            ids = [http.post("/v1/meshes", json=mesh(0.1 * number)).json()["id"] for number in range(5)]
        check_all_succeed(upgraded, ids)
        before = files_of(upgraded, ids)
        upgraded.page("upgrade.md", "back up 0.2")
        with upgraded.client() as http:  # these wait in the queue while the release changes
            waiting = [http.post("/v1/meshes", json=mesh(1 + 0.1 * number)).json()["id"] for number in range(20)]
        upgraded.copy("constraints.txt")
        upgraded.page("upgrade.md", "from 0.2")
        until(lambda: is_ready(FIRST), "the upgraded service is ready")
        check_all_succeed(upgraded, waiting)
        assert files_of(upgraded, ids) == before
        said = upgraded.shell("docker compose exec equimesh equimesh doctor --stored")
        assert "0 failed" in said
        line = (
            'docker compose exec database psql --username postgres --dbname equimesh -Atc "SELECT DISTINCT schemaname'
        )
        assert upgraded.shell(f"{line} FROM pg_tables WHERE tableowner = 'equimesh'\"").split() == ["equimesh"]
    finally:
        upgraded.down()
