"""Whether the workers of a run have the memory that its parts need: said before the start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from equimesh.cluster.errors import ClusterError
from equimesh.cluster.worker_facts import WorkerFacts
from equimesh.equations.problem import Problem
from equimesh.fields.chunked_samples import ChunkedSamples
from equimesh.meshes.grid import Grid

# Bytes that a part takes for each of its points, at its peak.
BYTES_A_POINT = 65
# Bytes that the spline through samples in a file takes for each of them.
BYTES_A_SAMPLE = 8
# The share of its limit at which a worker of Dask is ended.
LIMIT_SHARE = 0.95
GIGABYTE = 1e9


def check_memory(problem: Problem, places: Sequence[WorkerFacts], bytes_a_point: int = BYTES_A_POINT) -> None:
    """Refuse workers without the memory for their parts of ``problem``, which are nearly equal.

    Raises :class:`~equimesh.cluster.errors.ClusterError`, which names the worker or the machine and both numbers.
    """
    grid = problem.grid
    needed = memory_of_part(grid, len(places), bytes_a_point) + memory_of_samples(problem, len(places))
    for worker, parts in Counter(place.address for place in places).items():
        facts = next(place for place in places if place.address == worker)
        if facts.limit and parts * needed > LIMIT_SHARE * facts.limit - facts.used:
            free = max(0.0, LIMIT_SHARE * facts.limit - facts.used)
            raise _too_little(f"the worker {worker}", parts, needed, f"{_text(free)} left of its memory limit", grid)
    for host, parts in Counter(place.host for place in places).items():
        free = min(place.free for place in places if place.host == host)
        if parts * needed > free:
            raise _too_little(f"the machine {host}", parts, needed, f"{_text(free)} free", grid)


def memory_of_part(grid: Grid, count: int, bytes_a_point: int = BYTES_A_POINT) -> int:
    """Bytes that the largest of ``count`` parts of ``grid`` takes at its peak, beyond what its process has anyway."""
    rows = -(-grid.n_xi // count) + 2
    return bytes_a_point * rows * grid.n_eta


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
        f"{what} has {has}, and {those} of {grid} points take {_text(parts * needed)}: take more workers on more"
        " machines, raise the memory limit of the workers, or take a coarser grid"
    )


def _text(size: float) -> str:
    return f"{size / GIGABYTE:.3g} GB"
