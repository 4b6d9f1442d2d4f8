"""Whether the workers of a run have the memory that its parts need: said before the start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from equimesh.equations.problem import Problem
from equimesh.fields.chunked_samples import ChunkedSamples
from equimesh.meshes.grid import Grid
from equimesh.meshes.parts import rows_held
from equimesh_cluster.errors import ClusterError
from equimesh_cluster.worker_facts import WorkerFacts

# Bytes that a part takes for each of its points, at its peak.
BYTES_A_POINT = 65
# Bytes that the spline through samples in a file takes for each of them.
BYTES_A_SAMPLE = 8
# The share of its limit at which a worker of Dask is ended.
LIMIT_SHARE = 0.95
GIGABYTE = 1e9


def check_memory(
    problem: Problem,
    places: Sequence[WorkerFacts],
    bytes_a_point: int = BYTES_A_POINT,
    rows: Sequence[int] | None = None,
) -> None:
    """Refuse workers without the memory for their parts of ``problem``.

    ``rows`` are the rows that each part holds, by default those of parts that are cut between strips. Raises
    :class:`~equimesh_cluster.errors.ClusterError`, which names the worker or the machine and both numbers.
    """
    grid, count = problem.grid, len(places)
    samples = memory_of_samples(problem, count)
    held = rows_of_parts(grid, count) if rows is None else rows
    needs = [bytes_a_point * row_count * grid.n_eta + samples for row_count in held]
    for worker, parts in Counter(place.address for place in places).items():
        facts = next(place for place in places if place.address == worker)
        needed = sum(need for need, place in zip(needs, places, strict=True) if place.address == worker)
        if facts.limit and needed > LIMIT_SHARE * facts.limit - facts.used:
            free = max(0.0, LIMIT_SHARE * facts.limit - facts.used)
            raise _too_little(f"the worker {worker}", parts, needed, f"{_text(free)} left of its memory limit", grid)
    for host, parts in Counter(place.host for place in places).items():
        free = min(place.free for place in places if place.host == host)
        needed = sum(need for need, place in zip(needs, places, strict=True) if place.host == host)
        if needed > free:
            raise _too_little(f"the machine {host}", parts, needed, f"{_text(free)} free", grid)


def rows_of_parts(grid: Grid, count: int) -> list[int]:
    """The rows that each of ``count`` parts holds: parts are cut between strips, so few strips make uneven parts."""
    return [last - first for first, last in rows_held(grid.shape, count)]


def equal_rows(grid: Grid, count: int) -> list[int]:
    """The rows that each of ``count`` nearly equal parts holds."""
    return [-(-grid.n_xi // count) + 2] * count


def memory_of_samples(problem: Problem, count: int) -> int:
    """Bytes of the splines that each of ``count`` parts keeps where u is samples in a file: its share of them.

    A part evaluates u in its own share of the domain. It keeps no more than the ``max_bytes`` of the samples.
    """
    u = problem.monitor.u
    if not isinstance(u, ChunkedSamples):
        return 0
    n, m = u.shape
    return min(u.max_bytes, BYTES_A_SAMPLE * n * m // count)


def _too_little(what: str, parts: int, needed: int, has: str, grid: Grid) -> ClusterError:
    """The error of too little memory."""
    those = "a part" if parts == 1 else f"{parts} parts"
    return ClusterError(
        f"{what} has {has}, and {those} of {grid} points take {_text(needed)}: take more workers on more"
        " machines, raise the memory limit of the workers, or take a coarser grid"
    )


def _text(size: float) -> str:
    return f"{size / GIGABYTE:.3g} GB"
