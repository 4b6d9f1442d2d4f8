"""The image and the compose file: valid, consistent, and their commands run as plain processes.

No container engine is needed: what the image would run is run here, with the image's environment, but for the data
folder (a temporary one), the port (a free one), the database (a server here) and PATH (this environment's).
"""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from sqlalchemy import make_url

from equimesh_cli.checks import installation
from equimesh_cli.checks.installation import Level
from equimesh_service.settings import SERVICE_MIB, Settings, find_unknown
from generator.places import relinked
from programs import postgresql_program
from service.databases import Postgres

ROOT = Path(__file__).parents[2]
PASSWORD = "a password: @/?#"
SPEC = {"monitor": {"u": {"expression": "tanh(20*(x - y))"}}, "grid": {"n_xi": 9, "n_eta": 9}}


@dataclass
class Stage:
    """The instructions of one stage of a Dockerfile."""

    base: str
    environment: dict[str, str] = field(default_factory=dict)
    copies: list[list[str]] = field(default_factory=list)
    commands: dict[str, str] = field(default_factory=dict)  # the last of each other instruction
    runs: list[str] = field(default_factory=list)


def stages() -> list[Stage]:
    text = (ROOT / "Dockerfile").read_text()
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    found: list[Stage] = []
    for line in re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines():
        instruction, _, rest = line.partition(" ")
        if instruction == "FROM":
            found.append(Stage(rest.split()[0]))
        elif instruction == "ARG":
            continue
        elif instruction == "ENV":
            found[-1].environment |= dict(pair.split("=", 1) for pair in shlex.split(rest))
        elif instruction == "COPY":
            found[-1].copies.append(rest.split())
        elif instruction == "RUN":
            found[-1].runs.append(rest)
        else:
            found[-1].commands[instruction] = rest
    return found


def image() -> Stage:
    return stages()[-1]


def health_command() -> list[str]:
    _, _, command = image().commands["HEALTHCHECK"].partition("CMD ")
    words: list[str] = json.loads(command)
    return words


def compose() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((ROOT / "compose.yaml").read_text())
    return document


def by_default(value: str) -> str:
    """A value of the compose file when no variable is set: `${NAME:-default}` is the default."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", value)


def mebibytes(text: str) -> int:
    """An amount of memory as the compose file writes it, in MiB."""
    number, unit = re.fullmatch(r"(\d+)([mg])", by_default(text)).groups()  # type: ignore[union-attr]
    return int(number) * {"m": 1, "g": 1024}[unit]


def version() -> str:
    """The version of this release."""
    found = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    return found[1]


def compose_environment() -> dict[str, str]:
    """The service's environment when only the password is set."""
    given: dict[str, str] = compose()["services"]["equimesh"]["environment"]
    filled = {name: by_default(value) for name, value in given.items()}
    return {name: re.sub(r"\$\{POSTGRES_PASSWORD:\?[^}]+\}", PASSWORD, value) for name, value in filled.items()}


def check_schema(path: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_the_compose_file_is_valid(tmp_path: Path) -> None:
    done = check_schema(ROOT / "compose.yaml")
    assert done.returncode == 0, done.stdout + done.stderr
    wrong = tmp_path / "compose.yaml"
    wrong.write_text((ROOT / "compose.yaml").read_text().replace("restart:", "restarts:"))
    assert "restarts" in check_schema(wrong).stdout


def test_compose_and_image_are_of_one_mind() -> None:
    service, stage = compose()["services"]["equimesh"], image()
    assert service["image"] == f"equimesh:{version()}"
    assert service["healthcheck"]["test"] == ["CMD", *health_command()]
    volumes = dict(reversed(volume.split(":")) for volume in service["volumes"])
    assert set(volumes.values()) <= set(compose()["volumes"])
    # All folders that are written to: the data, and in it the loops of processors for which the image has no archive.
    assert set(volumes) == {stage.commands["VOLUME"]}
    assert stage.environment["EQUIMESH_CACHE_DIR"] == f"{stage.commands['VOLUME']}/loops"
    assert stage.commands["VOLUME"] == stage.environment["EQUIMESH_DATA_DIR"]
    assert compose_environment()["EQUIMESH_FILES_URL"] == f"file://{stage.commands['VOLUME']}/files"
    assert stage.environment["MPLCONFIGDIR"].startswith(service["tmpfs"][0].partition(":")[0])
    (port,) = service["ports"]
    assert port == f"127.0.0.1:8000:{stage.commands['EXPOSE']}"
    assert stage.commands["EXPOSE"] == stage.environment["EQUIMESH_PORT"]
    for option in ("interval", "timeout", "start_period", "retries"):
        assert f"--{option.replace('_', '-')}={service['healthcheck'][option]} " in stage.commands["HEALTHCHECK"]


def test_the_image_is_slim_and_not_run_by_root() -> None:
    assert {stage.base for stage in stages()} == {"${PYTHON_IMAGE}"}
    assert "ARG PYTHON_IMAGE=python:3.11-slim" in (ROOT / "Dockerfile").read_text().splitlines()
    arguments = compose()["services"]["equimesh"]["build"]["args"]
    assert {name: by_default(value) for name, value in arguments.items()} == {"PYTHON_IMAGE": "python:3.11-slim"}
    assert image().commands["USER"] not in ("root", "0")
    assert f"--uid {image().commands['USER']} " in " ".join(image().runs)
    _, install, tools, build, archive = stages()[0].runs
    assert archive.endswith("/python -m equimesh.warm_up --archive")
    assert install.endswith("/pip install --no-cache-dir --require-hashes -r locked.txt")
    assert tools.endswith(" --require-hashes --target /opt/site-tools -r locked-site.txt")  # none of it is in the image
    assert build.count("--no-deps --no-build-isolation") == 2  # nothing comes without a hash
    assert build.index("deploy/site") < build.index("--force-reinstall .") < build.index("slim.sh")


def test_every_service_of_compose_is_confined_and_watched() -> None:
    for name, part in compose()["services"].items():
        image_name = by_default(part["image"])
        assert re.fullmatch(r"([a-z]+/)?[a-z]+:v?\d+\.\d+(\.\d+)?", image_name), name  # no registry, no `latest`
        if image_name != f"equimesh:{version()}":
            assert part["image"].startswith("${"), name  # a digest can be given
            assert part["user"].partition(":")[0] not in ("root", "0"), name
        assert part["restart"] == "unless-stopped", name
        assert part["cap_drop"] == ["ALL"], name
        assert part["security_opt"] == ["no-new-privileges:true"], name
        assert part["healthcheck"]["test"][0] == "CMD", name
        assert all(port.startswith("127.0.0.1:") for port in part.get("ports", [])), name
        assert part["read_only"], name
        assert part["deploy"]["resources"]["limits"]["memory"], name
        assert part["deploy"]["resources"]["limits"]["pids"], name
        assert part["logging"] == {"driver": "json-file", "options": {"max-size": "10m", "max-file": "5"}}, name
        for place in part["tmpfs"]:  # other engines give it to root alone, and without a size it takes all memory
            assert re.fullmatch(r"/[a-z/]+:size=\d+m,mode=1777", place), name


def test_the_database_of_compose_is_that_of_the_service() -> None:
    document = compose()
    service, database = document["services"]["equimesh"], document["services"]["database"]
    assert service["depends_on"] == {"database": {"condition": "service_healthy"}}
    address = make_url(compose_environment()["EQUIMESH_DATABASE_URL"])
    assert (address.drivername, address.host, address.password) == ("postgresql+psycopg", "database", None)
    assert address.database == database["environment"]["POSTGRES_DB"] == "equimesh"
    # Not the superuser: a role that a script makes, which the image runs for a new volume.
    assert address.username == "equimesh" != database["environment"]["POSTGRES_USER"]
    (script,) = [volume.split(":") for volume in database["volumes"] if "initdb.d" in volume]
    assert os.access(ROOT / script[0], os.X_OK)
    assert script[1:] == ["/docker-entrypoint-initdb.d/own-schema.sh", "ro"]
    assert "--encoding=UTF8" in database["environment"]["POSTGRES_INITDB_ARGS"]
    assert service["environment"]["PGPASSWORD"] == database["environment"]["POSTGRES_PASSWORD"]
    assert compose_environment()["PGPASSWORD"] == PASSWORD  # there is no default: one must be given
    assert "ports" not in database
    (network,) = database["networks"]
    assert network in service["networks"]
    assert document["networks"][network]["internal"]


def test_the_cluster_of_compose_is_reached_by_the_service_alone() -> None:
    document = compose()
    services = document["services"]
    assert {name for name, part in services.items() if part.get("profiles") == ["cluster"]} == {"scheduler", "worker"}
    assert {name for name, part in services.items() if "cluster" in part.get("networks", ())} == {
        "equimesh",
        "equimesh-2",
        "scheduler",
        "worker",
    }
    assert document["networks"]["cluster"]["internal"]
    service, scheduler, worker = services["equimesh"], services["scheduler"], services["worker"]
    assert "ports" not in scheduler
    assert "ports" not in worker
    words = scheduler["command"]
    address = f"tcp://scheduler:{words[words.index('--port') + 1]}"
    assert (
        compose_environment()["EQUIMESH_SCHEDULER"]
        == by_default(worker["environment"]["EQUIMESH_SCHEDULER"])
        == address
    )
    assert compose_environment()["EQUIMESH_ENGINE"] == "processes"  # it needs no cluster unless one is wanted
    for part in (scheduler, worker):
        assert part["image"] == service["image"]
        assert part["healthcheck"]["test"][-1].count(":8787/health") == 1
    assert worker["volumes"] == service["volumes"]  # the same files, and the same compiled loops
    assert worker["environment"]["PGPASSWORD"] == service["environment"]["PGPASSWORD"]
    settings = Settings(
        workers=by_default(worker["environment"]["EQUIMESH_WORKERS"]),
        memory_limit=compose_environment()["EQUIMESH_MEMORY_LIMIT"],
    )
    (scratch,) = re.findall(r"size=(\d+)m", worker["tmpfs"][0])
    most = settings.workers * settings.memory_limit + SERVICE_MIB + int(scratch)
    assert most == mebibytes(worker["deploy"]["resources"]["limits"]["memory"])


def test_the_replica_of_compose_is_the_service_at_another_port() -> None:
    services = compose()["services"]
    first, second = services["equimesh"], services["equimesh-2"]
    assert second["profiles"] == ["replica"]
    assert second["ports"] == ["127.0.0.1:8001:8000"]
    assert "equimesh" in second["networks"]["default"]["aliases"]
    same = set(first) - {"ports", "networks"}
    assert {name: second[name] for name in same} == {name: first[name] for name in same}


def test_compose_gives_its_workers_the_memory_that_they_may_take(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = compose_environment()
    settings = Settings(workers=asked["EQUIMESH_WORKERS"], memory_limit=asked["EQUIMESH_MEMORY_LIMIT"])
    limits = compose()["services"]["equimesh"]["deploy"]["resources"]["limits"]
    (scratch,) = re.findall(r"size=(\d+)m", compose()["services"]["equimesh"]["tmpfs"][0])
    assert settings.most_memory + int(scratch) == mebibytes(limits["memory"])
    (processors,) = re.findall(r":-(\d+)\}", limits["cpus"])
    assert int(processors) == settings.workers
    monkeypatch.setattr(installation, "allowed_memory", lambda: mebibytes(limits["memory"]) * installation.MIB)
    monkeypatch.setattr(os, "sysconf", {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 1 << 24}.__getitem__)
    assert installation.memory(settings).level is Level.OK
    page = (ROOT / "docs/how-to/deploy.md").read_text()
    names = re.findall(r"^EQUIMESH_(WORKERS)=(\d+)$", page, re.MULTILINE)
    larger = Settings(memory_limit=settings.memory_limit, **{name.lower(): number for name, number in names})
    assert f"MEMORY={larger.most_memory + int(scratch)}m" in page


def test_the_unit_gives_its_workers_the_memory_that_they_may_take() -> None:
    (options,) = re.findall(r"equimesh config --env (.*) >", (ROOT / "docs/how-to/deploy.md").read_text())
    given = {name.replace("-", "_"): value for name, value in re.findall(r"--([a-z-]+) (\d+)", options)}
    assert f"MemoryMax={Settings(**given).most_memory // 1024}G" in unit()
    assert "OOMPolicy=continue" in unit().splitlines()  # the end of one worker must not be that of the service


def unit() -> str:
    return (ROOT / "deploy/equimesh.service").read_text()


@pytest.mark.needs("systemd-analyze")
def test_the_unit_of_systemd_is_valid_and_confined(tmp_path: Path) -> None:
    assert find_unknown(dict.fromkeys(re.findall(r"(EQUIMESH_[A-Z_]+)=", unit()), "")) == {}
    assert "MemoryDenyWriteExecute=" not in unit()  # the compiler of the loops could not work
    copy = tmp_path / "equimesh.service"
    copy.write_text(unit().replace("/opt/equimesh/bin/", f"{Path(sys.executable).parent}/"))

    def analyse(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["systemd-analyze", *words, str(copy)], capture_output=True, text=True, timeout=300)

    done = analyse("verify")
    assert (done.returncode, done.stderr) == (0, "")
    assert analyse("security", "--offline=true", "--threshold=25").returncode == 0  # tenths: 0 is safe, 100 is not
    copy.write_text(copy.read_text().replace("ProtectSystem=", "ProtectSistem="))
    assert "ProtectSistem" in analyse("verify").stderr


def test_settings_of_the_image_and_of_compose_exist() -> None:
    for environment in (image().environment, compose_environment()):
        assert find_unknown(environment) == {}
        assert "EQUIMESH_ALLOW_ANONYMOUS" not in environment  # whoever wants it open says so


def test_the_monitoring_profile_finds_its_files_and_runs_known_versions() -> None:
    document = compose()
    watching = {name: part for name, part in document["services"].items() if part.get("profiles") == ["monitoring"]}
    assert set(watching) == {"prometheus", "grafana"}
    for part in watching.values():
        for volume in part["volumes"]:
            source = volume.partition(":")[0]
            assert (ROOT / source).is_file() if source.startswith(".") else source in document["volumes"], volume
    key = document["secrets"]["metrics_key"]["file"]
    assert (ROOT / key.rpartition(":-")[2].rstrip("}")).read_text() == ""
    job = yaml.safe_load((ROOT / "deploy/prometheus.yml").read_text())["scrape_configs"][0]
    assert job["dns_sd_configs"][0]["names"] == ["equimesh"]
    assert job["dns_sd_configs"][0]["port"] == int(image().commands["EXPOSE"])
    assert job["authorization"]["credentials_file"] == "/run/secrets/metrics_key"
    (source,) = yaml.safe_load((ROOT / "deploy/grafana/datasource.yml").read_text())["datasources"]
    dashboard = (ROOT / "deploy/grafana/equimesh.json").read_text()
    assert set(re.findall(r'"type": "prometheus",\s*"uid": "(\w+)"', dashboard)) == {source["uid"]}


def test_the_documentation_runs_this_release() -> None:
    for page in sorted((ROOT / "docs").glob("*.md")):
        for name in re.findall(r"\bequimesh:(\d+\.\d+\.\d+)", page.read_text()):
            assert name == version(), page.name


def test_what_the_image_copies_is_in_the_context() -> None:
    rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] != "#"]
    for copy in stages()[0].copies:
        for source in copy[:-1]:
            assert (ROOT / source).exists(), source
            ignored = False
            for rule in rules:
                if fnmatch.fnmatch(source, rule.lstrip("!")):
                    ignored = not rule.startswith("!")
            assert not ignored, source
    copied = [source for copy in stages()[0].copies for source in copy[:-1]]
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert all(any(package.startswith(source) for source in copied) for package in wheel["packages"])


def test_what_pages_link_to_is_in_the_image_that_builds_the_site() -> None:
    copied = [source for copy in stages()[0].copies for source in copy[:-1]]
    linked: set[str] = set()
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "examples" / "README.md"]:
        relinked(path.read_text(), path.relative_to(ROOT).as_posix(), linked.add)
    assert len(linked) > 50
    assert {path for path in linked if not any(path == one or path.startswith(f"{one}/") for one in copied)} == set()


@pytest.mark.external
@pytest.mark.everything  # what is copied is in an earlier test, the wheel in tests/external/test_base_install.py
def test_what_the_image_copies_makes_the_whole_wheel(tmp_path: Path) -> None:
    for copy in stages()[0].copies:
        for source in copy[:-1]:
            if (ROOT / source).is_dir():
                shutil.copytree(ROOT / source, tmp_path / source)
            else:
                (tmp_path / source).parent.mkdir(exist_ok=True)
                shutil.copy(ROOT / source, tmp_path / source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", "wheel", "--no-deps"]
    subprocess.run([*pip, "-w", str(tmp_path / "wheel"), str(tmp_path)], check=True, timeout=300)
    (wheel,) = (tmp_path / "wheel").iterdir()
    names = subprocess.run([sys.executable, "-m", "zipfile", "-l", str(wheel)], capture_output=True, text=True).stdout
    for package in ("equimesh", "equimesh_cluster", "equimesh_client", "equimesh_cli", "equimesh_service"):
        assert f"{package}/__init__.py" in names


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def environment(folder: Path, database: str) -> dict[str, str]:
    """The environment of the container, as far as it works outside of one; each has a port of its own."""
    merged = {**image().environment, **compose_environment()}
    here = {
        "PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin",
        "HOME": str(folder),
        "EQUIMESH_DATABASE_URL": database,
        "EQUIMESH_DATA_DIR": str(folder / "data"),
        "EQUIMESH_FILES_URL": f"file://{folder}/data/files",
        "EQUIMESH_PORT": str(free_port()),
        "MPLCONFIGDIR": str(folder / "matplotlib"),
        "EQUIMESH_CACHE_DIR": str(folder / "loops"),
    }
    return {**merged, **here}


def healthy(environment: dict[str, str]) -> bool:
    done = subprocess.run(health_command(), env=environment, capture_output=True, timeout=300)
    assert done.returncode in (0, 1)
    return done.returncode == 0


@contextmanager
def container(environment: dict[str, str]) -> Iterator[None]:
    """The command of the image as a process; stopped with SIGTERM, as a container engine does it."""
    command: list[str] = json.loads(image().commands["CMD"])
    log = Path(environment["HOME"]) / "log.txt"
    with log.open("w") as output:
        process = subprocess.Popen(command, env=environment, cwd=os.sep, stderr=output)
    try:
        deadline = time.monotonic() + 90
        while not healthy(environment):
            assert process.poll() is None, "the service ended"
            assert time.monotonic() < deadline, "the service does not get healthy"
        yield
        process.send_signal(signal.SIGTERM)
        grace = int(compose()["services"]["equimesh"]["stop_grace_period"].removesuffix("s"))
        # uvicorn shuts down first, and then ends by the signal that it was sent
        assert process.wait(grace) in (0, -signal.SIGTERM)
        assert "Application shutdown complete" in log.read_text()
    finally:
        process.kill()
        process.wait()


def documented(page: str, beginning: str) -> list[str]:
    """The command of a page that begins so, without the part for compose."""
    text = (ROOT / "docs" / "how-to" / page).read_text()
    (line,) = re.findall(rf"^docker compose run --rm equimesh ({re.escape(beginning)}.*)$", text, re.MULTILINE)
    return shlex.split(line)


def test_the_database_s_health_check_tells_whether_it_answers(postgres: Postgres, tmp_path: Path) -> None:
    _, program, *words = compose()["services"]["database"]["healthcheck"]["test"]
    host = make_url(postgres.url).query.get("host") or make_url(postgres.url).host

    def answers(place: str) -> bool:
        command = [postgresql_program(program) or "", *(place if word == "127.0.0.1" else word for word in words)]
        return subprocess.run(command, timeout=300).returncode == 0

    assert answers(str(host))
    assert not answers(str(tmp_path))


@pytest.mark.everything  # it compiles all kernels anew: a minute and a half of a processor
def test_the_commands_of_the_image_run(tmp_path: Path, postgres: Postgres) -> None:
    with postgres.database() as database:
        variables, others = environment(tmp_path, database), environment(tmp_path, database)
        url, second = (f"http://127.0.0.1:{one['EQUIMESH_PORT']}" for one in (variables, others))

        def command(*words: str) -> subprocess.CompletedProcess[str]:
            return subprocess.run(words, env=variables, cwd=os.sep, capture_output=True, text=True, timeout=240)

        assert not healthy(variables)
        archive = stages()[0].runs[-1].partition("/python ")[2]
        done = command(sys.executable, *shlex.split(archive), str(tmp_path / "an.archive"))
        assert done.returncode == 0, done.stderr
        compiled = {path: path.stat().st_mtime_ns for path in (tmp_path / "loops").rglob("*-*")}
        assert len(compiled) > 100, "the image ships no compiled loops"
        secret = command(*documented("deploy.md", "equimesh keys create")).stdout.split()[0]
        key = {"Authorization": f"Bearer {secret}"}
        with container(variables):
            asked = {**key, "Prefer": "wait=30"}
            assert httpx.post(f"{url}/v1/meshes", json=SPEC).status_code == 401
            made = httpx.post(f"{url}/v1/meshes", json=SPEC, headers=asked, timeout=40)
            assert made.json()["status"] == "succeeded"
            parts = {**SPEC, "grid": {"n_xi": 200, "n_eta": 190}, "schwarz": {"subdomains": [2, 2]}}
            many = httpx.post(f"{url}/v1/meshes", json=parts, headers=asked, timeout=40)
            assert many.json()["status"] == "succeeded"
            with container(others):  # the database and the volume are all that a replica has of the first
                again = httpx.get(second + made.headers["Location"], headers=key)
                assert again.json()["status"] == "succeeded"
                assert httpx.get(second + again.json()["links"]["file"], headers=key).status_code == 200
                asked_of = (["--stored"], ["--url", second, "--key", secret])
                said = [command("equimesh", "doctor", "--json", *words) for words in asked_of]
            assert [done.returncode for done in said] == [0, 0], [done.stdout for done in said]
            found = [check for done in said for check in json.loads(done.stdout)["checks"]]
            checks = {check["check"]: check["level"] for check in found}
            assert {checks[name] for name in ("database", "clock", "files", "stored", "port", "exposure")} == {"ok"}
            assert {checks[name] for name in ("ready", "version", "key", "round trip")} == {"ok"}
        assert not (tmp_path / "data" / "equimesh.sqlite3").exists()
        assert {path: path.stat().st_mtime_ns for path in (tmp_path / "loops").rglob("*-*")} == compiled
        assert not healthy(variables)
