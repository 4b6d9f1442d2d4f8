"""The metrics of a service, for Prometheus. Each service has a registry of its own."""

import platform
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Info, ProcessCollector
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from equimesh_service.store.rows import CANCELED, FAILED, QUEUED, STATUSES, SUCCEEDED, Ending, QueueCounts

UNMATCHED = "unmatched"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_WAIT_SECONDS = (0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0, 300.0, 1800.0)
_SOLVE_SECONDS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
_REQUEST_SECONDS = (0.002, 0.005, 0.015, 0.04, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The values that are read at a scrape: workers of each pool, and the counts of the store, None when it is down."""

    workers: dict[str, int]
    counts: QueueCounts | None


class Metrics:
    """The metrics of one service. All methods are fast, and may be called from any thread."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        here = self.registry
        Info("equimesh_build", "Version of the service.", registry=here).info(
            {"version": version("equimesh"), "python": platform.python_version()}
        )
        self._finished = Counter(
            "equimesh_meshes_finished", "Meshes that ended here.", ("status", "reason"), registry=here
        )
        self._points = Counter("equimesh_mesh_points", "Points of meshes that succeeded here.", registry=here)
        self._attempts = Counter("equimesh_mesh_attempts", "Attempts at meshes that began here.", registry=here)
        self._retries = Counter(
            "equimesh_mesh_retries", "Meshes that wait again because an attempt was lost.", registry=here
        )
        self._lost = Counter("equimesh_workers_lost", "Worker processes that died over a mesh.", registry=here)
        self._reused = Counter("equimesh_meshes_reused", "Requests answered with an earlier mesh.", registry=here)
        self._samples = Counter("equimesh_samples_uploaded", "Samples that were uploaded.", registry=here)
        self._wait = Histogram(
            "equimesh_queue_wait_seconds", "From the request to an attempt.", buckets=_WAIT_SECONDS, registry=here
        )
        self._solve = Histogram(
            "equimesh_solve_seconds",
            "Solve time of meshes, without their files.",
            buckets=_SOLVE_SECONDS,
            registry=here,
        )
        self._streams = Gauge("equimesh_event_streams", "Open streams of events (SSE).", registry=here)
        labels = ("method", "route", "status")
        self._requests = Counter("equimesh_http_requests", "Requests that were answered.", labels, registry=here)
        self._duration = Histogram(
            "equimesh_http_request_duration_seconds",
            "From a request to the end of its answer.",
            labels,
            buckets=_REQUEST_SECONDS,
            registry=here,
        )
        self._sent = Counter("equimesh_http_response_bytes", "Bytes of bodies that were sent.", registry=here)
        self._answered: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        for status in (SUCCEEDED, CANCELED):
            self._finished.labels(status, "")  # from the start, so that rates see the first one
        self._finished.labels(FAILED, "worker-lost")

    def add_snapshots(self, take: Callable[[], Snapshot]) -> None:
        """Call ``take`` at each scrape."""
        self.registry.register(_SnapshotCollector(take))

    def scrape(self, accept: str) -> tuple[bytes, str]:
        """All metrics in the text format that ``accept`` requests, and its media type."""
        try:
            encode, media_type = choose_encoder(accept)
        except (TypeError, ValueError):  # an invalid version
            encode, media_type = choose_encoder("")
        return encode(self.registry), media_type

    def count_attempt(self, waited: float) -> None:
        """Count an attempt at a mesh that waited this many seconds."""
        self._attempts.inc()
        self._wait.observe(waited)

    def count_end(self, ending: Ending) -> None:
        """Count the end of a mesh, with the files that came with its request."""
        self.count_uploads(ending.uploads)
        self._finished.labels(ending.status, ending.reason).inc()
        if ending.status == SUCCEEDED:
            self._points.inc(ending.points)
        if ending.solve_seconds is not None:
            self._solve.observe(ending.solve_seconds)

    def count_lost_worker(self) -> None:
        """Count a worker process that died while it had a mesh."""
        self._lost.inc()

    def count_lost_attempt(self, status: str) -> None:
        """Count a lost attempt; ``status`` is the new status of its mesh."""
        if status == QUEUED:
            self._retries.inc()
        else:
            self.count_end(Ending(status=status, reason="worker-lost"))

    def count_reuse(self) -> None:
        """Count a request answered with an earlier mesh."""
        self._reused.inc()

    def count_uploads(self, number: int) -> None:
        """Count files of samples and of meshes that clients have sent."""
        self._samples.inc(number)

    @contextmanager
    def count_stream(self) -> Iterator[None]:
        """Count an open stream of events for the length of a ``with``."""
        with self._streams.track_inprogress():
            yield

    def count_answer(self, method: str, route: str, status: int, seconds: float, size: int) -> None:
        """Count an answered request; ``route`` is the template of its path."""
        key = (method if method in _METHODS else "other", route, status)
        found = self._answered.get(key)
        if found is None:
            found = self._requests.labels(*key), self._duration.labels(*key)
            self._answered[key] = found
        found[0].inc()
        found[1].observe(seconds)
        self._sent.inc(size)


class _SnapshotCollector(Collector):
    """The metrics that are read at a scrape, not counted."""

    def __init__(self, take: Callable[[], Snapshot]) -> None:
        self._take = take

    def describe(self) -> Iterable[Metric]:
        """Nothing: these metrics are known only at a scrape."""
        return ()

    def collect(self) -> Iterable[Metric]:
        snapshot = self._take()
        workers = GaugeMetricFamily("equimesh_workers", "Worker processes that are meant to run.", labels=("pool",))
        for pool, count in snapshot.workers.items():
            workers.add_metric((pool,), count)
        yield workers
        up = snapshot.counts is not None
        yield GaugeMetricFamily("equimesh_store_up", "1 when the database answers.", value=float(up))
        if snapshot.counts is None:
            return
        meshes = GaugeMetricFamily("equimesh_meshes", "Meshes in the store.", labels=("status",))
        for status in STATUSES:
            meshes.add_metric((status,), snapshot.counts.meshes[status])
        yield meshes
        yield GaugeMetricFamily("equimesh_queue_depth", "Waiting meshes.", value=snapshot.counts.meshes[QUEUED])
        yield GaugeMetricFamily(
            "equimesh_queue_oldest_seconds",
            "How long the oldest waiting mesh waits.",
            value=snapshot.counts.oldest_wait,
        )
