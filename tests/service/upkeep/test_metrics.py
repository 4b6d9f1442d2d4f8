"""Metrics: each changes with its event, over a real service; labels are bounded; documents name existing metrics."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
import yaml
from prometheus_client.openmetrics.parser import text_string_to_metric_families as read_openmetrics
from prometheus_client.parser import text_string_to_metric_families as read_text
from starlette.responses import Response

from equimesh_cli import main
from equimesh_service import Settings, running
from equimesh_service.admission.callers import ANYONE
from equimesh_service.admission.intake import Intake
from equimesh_service.api.app import create_app
from equimesh_service.api.middleware import Observation
from equimesh_service.errors import ExposedError
from equimesh_service.store.rows import STATUSES, Ending, QueueCounts
from equimesh_service.store.store import Store
from equimesh_service.upkeep.exposure import check_exposure, is_loopback
from equimesh_service.upkeep.metrics import Metrics, Snapshot
from service.conftest import SLOW, small, until
from service.processes import children
from service.requests import WAIT

ROOT = Path(__file__).parents[3]

Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def read(text: str) -> Samples:
    """All samples of a scrape, by name and labels."""
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in read_text(text)
        for sample in family.samples
    }


class Watch:
    """The changes of metrics since the last scrape."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http
        self.before = self._scrape()

    def _scrape(self) -> Samples:
        answer = self._http.get("/metrics")
        assert answer.status_code == 200
        return read(answer.text)

    def now(self, name: str, **labels: str) -> float:
        """The value now; 0 where there is none."""
        return self._scrape().get((name, tuple(sorted(labels.items()))), 0.0)

    def moved(self, name: str, **labels: str) -> float:
        """The difference."""
        return self.now(name, **labels) - self.before.get((name, tuple(sorted(labels.items()))), 0.0)


@pytest.fixture
def watch(http: httpx.Client) -> Watch:
    return Watch(http)


def test_a_mesh_moves_what_is_counted(http: httpx.Client, watch: Watch) -> None:
    answer = http.post("/v1/meshes?format=npz&reuse=false", json=small(), headers=WAIT)
    assert answer.status_code == 201
    until(lambda: watch.moved("equimesh_meshes_finished_total", status="succeeded", reason="") == 1)
    here = {"method": "POST", "route": "/v1/meshes", "status": "201"}
    for name in ("equimesh_mesh_attempts_total", "equimesh_queue_wait_seconds_count", "equimesh_solve_seconds_count"):
        assert watch.moved(name) == 1, name
    assert watch.moved("equimesh_mesh_points_total") == 72
    assert watch.moved("equimesh_solve_seconds_sum") > 0
    assert watch.moved("equimesh_meshes", status="succeeded") == 1
    assert watch.moved("equimesh_http_requests_total", **here) == 1
    assert watch.moved("equimesh_http_request_duration_seconds_count", **here) == 1
    assert watch.moved("equimesh_http_request_duration_seconds_sum", **here) > 0
    assert watch.moved("equimesh_http_response_bytes_total") >= len(answer.content)
    assert watch.now("equimesh_workers", pool="solve") == 2
    assert watch.now("equimesh_store_up") == 1


def test_failures_are_counted_by_their_problem(http: httpx.Client, watch: Watch) -> None:
    strict = {**SLOW["schwarz"], "tolerance": 1e-10, "max_iterations": 1}
    mesh = http.post("/v1/meshes", json=small(schwarz={**strict, "subdomains": [2, 1]}), headers=WAIT).json()
    assert mesh["status"] == "failed"
    until(lambda: watch.moved("equimesh_meshes_finished_total", status="failed", reason="not-converged") == 1)
    assert watch.moved("equimesh_meshes", status="failed") == 1
    assert watch.moved("equimesh_mesh_points_total") == 0


def test_the_queue_streams_and_cancels(http: httpx.Client, watch: Watch) -> None:
    slow = [http.post("/v1/meshes", json=SLOW).json()["links"] for _ in range(2)]
    until(lambda: watch.moved("equimesh_meshes", status="running") == 2)
    waiting = http.post("/v1/meshes?reuse=false", json=small()).json()["links"]
    try:
        assert watch.moved("equimesh_queue_depth") == watch.moved("equimesh_meshes", status="queued") == 1
        oldest = until(lambda: watch.now("equimesh_queue_oldest_seconds"))
        assert until(lambda: watch.now("equimesh_queue_oldest_seconds") > oldest)
        with http.stream("GET", slow[0]["events"]) as stream:
            lines = stream.iter_lines()
            assert next(lines).startswith("retry")
            assert watch.moved("equimesh_event_streams") == 1
        until(lambda: watch.moved("equimesh_event_streams") == 0)
    finally:
        for links in [*slow, waiting]:
            http.delete(links["self"])
    until(lambda: watch.moved("equimesh_queue_depth") == 0)
    assert watch.now("equimesh_queue_oldest_seconds") == 0
    until(lambda: watch.moved("equimesh_meshes_finished_total", status="canceled", reason="") == 3)


def busiest() -> int:
    """The process below this one that works; on a busy machine it takes a while to find."""
    before = {pid: ticks(pid) for pid in children(os.getpid())}
    used: dict[int, int] = until(
        lambda: max((now := {pid: ticks(pid) - then for pid, then in before.items()}).values()) > 10 and now
    )
    return max(used, key=lambda pid: used[pid])


def kill_the_worker(watch: Watch) -> None:
    """Kill the worker that solves; one that only warms up may be busier for a moment, and be killed instead."""
    for _ in range(5):
        os.kill(busiest(), signal.SIGKILL)
        with suppress(AssertionError):
            until(lambda: watch.moved("equimesh_workers_lost_total") == 1, 30.0)
            return
    raise AssertionError("no kill was noticed")


def ticks(pid: int) -> int:
    """Processor time of a process, in hundredths of a second; 0 for one that is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0
    return int(fields[11]) + int(fields[12])


@pytest.mark.skipif(sys.platform != "linux", reason="it looks for the worker in /proc")
def test_a_killed_worker_is_lost_and_its_mesh_tried_again(http: httpx.Client, watch: Watch) -> None:
    links = http.post("/v1/meshes", json=SLOW).json()["links"]
    try:
        until(lambda: http.get(links["self"]).json()["progress"]["phase"])
        kill_the_worker(watch)
        until(lambda: watch.moved("equimesh_mesh_attempts_total") == 2)
        assert watch.moved("equimesh_mesh_retries_total") == 1
    finally:
        http.delete(links["self"])


def test_samples_are_counted(http: httpx.Client, watch: Watch) -> None:
    assert http.post("/v1/samples", json={"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [1, 5]]}}).is_success
    assert watch.moved("equimesh_samples_uploaded_total") == 1
    spec = small(monitor={"kind": "arc_length", "u": {"samples": "upload"}})
    parts = {"spec": (None, json.dumps(spec)), "samples": ("a.csv", "x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,5\n")}
    assert http.post("/v1/meshes", files=parts).is_success
    assert watch.moved("equimesh_samples_uploaded_total") == 2


def test_samples_of_a_mesh_that_outlasts_its_wait_are_counted(
    http: httpx.Client, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Intake, "_wait_for", lambda *_: asyncio.sleep(0.01))
    schwarz = {**SLOW["schwarz"], "max_iterations": 60}
    spec = {**SLOW, "monitor": {"kind": "arc_length", "u": {"samples": "upload"}}, "schwarz": schwarz}
    parts = {"spec": (None, json.dumps(spec)), "samples": ("a.csv", "x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,5\n")}
    posted = http.post("/v1/meshes", files=parts, headers={"Prefer": "wait=1"})
    assert (posted.status_code, posted.json()["status"]) == (202, "running")
    assert http.get(f"{posted.headers['location']}?wait=60").json()["attempts"] == 1
    assert watch.moved("equimesh_samples_uploaded_total") == 1


@pytest.mark.anyio
async def test_reused_meshes_are_counted_by_their_header() -> None:
    metrics = Metrics()
    for headers, count in (({}, 0.0), ({"Equimesh-Reused": "m-1"}, 1.0)):
        app = Observation(Response(headers=headers), metrics=metrics, tracer=None)
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as http:
            assert (await http.post("/")).is_success
        assert read(metrics.scrape("")[0].decode())[("equimesh_meshes_reused_total", ())] == count


def test_labels_are_bounded(http: httpx.Client, watch: Watch) -> None:
    for method, path in (("GET", "/no/such/path"), ("GET", "/v1/meshes/m-0abc"), ("BREW", "/livez"), ("PUT", "/livez")):
        assert http.request(method, path).status_code in (404, 405)
    for labels in (
        {"method": "GET", "route": "unmatched", "status": "404"},
        {"method": "GET", "route": "/v1/meshes/{id}", "status": "404"},
        {"method": "other", "route": "/livez", "status": "405"},
        {"method": "PUT", "route": "/livez", "status": "405"},
    ):
        assert watch.moved("equimesh_http_requests_total", **labels) == 1, labels
    text = http.get("/metrics").text
    assert "BREW" not in text
    assert not re.search(r"m-[0-9a-f]{3,}|/no/such", text)


def test_both_formats_of_prometheus(http: httpx.Client) -> None:
    for accept, kind in (
        ("", "text/plain; version=0.0.4"),
        ("application/openmetrics-text;version=1.0.0", "application/openmetrics-text; version=1.0.0"),
        ("application/openmetrics-text;version=none", "text/plain; version=0.0.4"),
    ):
        answer = http.get("/metrics", headers={"Accept": accept})
        assert answer.headers["content-type"].startswith(kind)
        parse = read_openmetrics if "openmetrics" in kind else read_text
        assert "equimesh_meshes" in {family.name for family in parse(answer.text)}


def test_services_do_not_share_their_metrics() -> None:
    one, other = Metrics(), Metrics()
    one.count_end(Ending(status="failed", reason="folded"))
    name = 'equimesh_meshes_finished_total{reason="folded",status="failed"}'
    assert f"{name} 1.0" in one.scrape("")[0].decode()
    assert name not in other.scrape("")[0].decode()


def test_a_scrape_does_without_the_store() -> None:
    metrics = Metrics()
    metrics.add_snapshots(lambda: Snapshot(workers={"solve": 1}, counts=None))
    samples = read(metrics.scrape("")[0].decode())
    assert samples[("equimesh_store_up", ())] == 0
    assert ("equimesh_queue_depth", ()) not in samples
    assert samples[("equimesh_mesh_points_total", ())] == 0


@pytest.mark.anyio
async def test_metrics_can_be_switched_off(tmp_path: Path) -> None:
    app = create_app(Settings(data_dir=tmp_path, metrics=False))

    async def anyone(_: Any) -> Any:
        return ANYONE

    app.state.service = SimpleNamespace(
        settings=Settings(metrics=False),
        callers=SimpleNamespace(identify=anyone),
        quotas=SimpleNamespace(count_request=lambda _: {}),
    )
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost") as http:
        answer = await http.get("/metrics")
    assert (answer.status_code, answer.json()["type"]) == (404, "/problems/not-found")
    assert "EQUIMESH_METRICS" in answer.json()["detail"]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def families() -> dict[str, tuple[str, set[str]]]:
    """Type and labels of all metrics of a service, by the name that queries use."""
    metrics = Metrics()
    metrics.add_snapshots(
        lambda: Snapshot(workers={"solve": 1}, counts=QueueCounts(meshes=dict.fromkeys(STATUSES, 0), oldest_wait=0))
    )
    metrics.count_end(Ending(status="succeeded", solve_seconds=1.0))
    metrics.count_answer("GET", "/", 200, 0.1, 1)
    found = {}
    for family in metrics.registry.collect():
        labels = {name for sample in family.samples for name in sample.labels} - {"le"}
        found[family.name + ("_total" if family.type == "counter" else "")] = (family.type, labels)
    found["equimesh_build_info"] = ("gauge", found.pop("equimesh_build")[1])
    return found


def test_the_document_lists_all_metrics() -> None:
    rows = re.findall(
        r"^\| `(equimesh_\w+)` \| (\w+)[^|]*\|([^|]*)\|", (ROOT / "docs/how-to/observe.md").read_text(), re.M
    )
    told = {name: (kind, set(re.findall(r"`(\w+)`", labels.partition(":")[0]))) for name, kind, labels in rows}
    assert told == {name: shape for name, shape in families().items() if name.startswith("equimesh_")}


def queries() -> Iterator[tuple[str, str]]:
    """Every query of the dashboard, the rules and the document, with its place."""
    for panel in json.loads((ROOT / "deploy/grafana/equimesh.json").read_text())["panels"]:
        for target in panel.get("targets", ()):
            yield panel["title"], target["expr"]
    for rule in yaml.safe_load((ROOT / "deploy/alerts.yml").read_text())["groups"][0]["rules"]:
        yield rule["alert"], rule["expr"]
    page = (ROOT / "docs/how-to/observe.md").read_text()
    for cells in re.findall(r"^\| [^|]* \| `((?:[^`|]|\\\|)*(?:equimesh|process)_(?:[^`|]|\\\|)*)` \| ", page, re.M):
        if " " in cells:
            yield "docs/how-to/observe.md", cells.replace("\\|", "|")


def test_queries_name_only_what_there_is() -> None:
    known: dict[str, set[str]] = {}
    for name, (kind, labels) in families().items():
        parts = ("_bucket", "_sum", "_count") if kind == "histogram" else ("",)
        known.update({name + part: labels | ({"le"} if part == "_bucket" else set()) for part in parts})
    seen = list(queries())
    assert len(seen) > 30
    assert sum(where == "docs/how-to/observe.md" for where, _ in seen) >= 5
    for where, query in seen:
        plain = re.sub(r'"[^"]*"', '""', query)
        names = set(re.findall(r"\b(?:equimesh|process)_\w+", plain))
        assert names <= set(known) or names == set(), (where, names - set(known))
        assert names or "up{" in plain, where
        grouped = {label for group in re.findall(r"by \(([^)]*)\)", plain) for label in re.split(r", *", group)}
        chosen = set(re.findall(r"[{,] *(\w+) *(?:=~|!~|!=|=)", plain))
        allowed = {label for name in names for label in known[name]} | {"job", "instance"}
        assert grouped | chosen <= allowed, (where, grouped | chosen - allowed)


def test_the_alerts_of_the_document_are_the_rules() -> None:
    rules = {re.sub(r"\s+", " ", query) for where, query in queries() if where.startswith("Equimesh")}
    told = {query for where, query in queries() if where == "docs/how-to/observe.md"}
    assert told <= rules
    assert all('up{job="equimesh"}' in rule for rule in rules - told)  # whether Prometheus finds the services at all


@pytest.mark.parametrize(
    ("host", "inside"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),
     ("10.0.0.7", False), ("", False), ("service.example", False), ("localhost.example", False)],
)  # fmt: skip
def test_which_addresses_only_this_machine_reaches(host: str, inside: bool) -> None:
    assert is_loopback(host) is inside


def test_others_are_not_served_without_a_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    public = ["serve", "--host", "0.0.0.0", "--port", "0", "--data-dir", str(tmp_path)]
    assert main(public) == 2
    told = capsys.readouterr().err
    assert f"`equimesh keys create --name NAME --scope write --data-dir {tmp_path}`" in told
    assert "--allow-anonymous true" in told
    settings = Settings(data_dir=tmp_path, host="0.0.0.0")
    with pytest.raises(ExposedError), running(settings):
        pass
    check_exposure(settings.model_copy(update={"allow_anonymous": True}))
    store = Store(settings.database)
    row, _ = store.keys.create("only", ["admin"])
    store.keys.revoke(row.id)  # it closed the service, and its end does not open it
    store.close()
    check_exposure(settings)
