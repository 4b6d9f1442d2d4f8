"""The mesh of a domain in blocks by the workers of a cluster: one block, or a group of blocks, a subdomain."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from typing import Any

from distributed import Client

from equimesh.equations.block_problem import BlockProblem
from equimesh.errors import InputError
from equimesh.least_error.block_schwarz import BlockSchwarz
from equimesh.least_error.steps import Descent
from equimesh.numerics.threads import thread_count
from equimesh.solving.block_solution import BlockSolution
from equimesh.solving.blocks import count_subdomains
from equimesh.solving.solution import SolveError
from equimesh_cluster.connection import check_client, connect
from equimesh_cluster.inputs import sent
from equimesh_cluster.parts.blocks import BlocksResult, plain, solve_part_of_blocks
from equimesh_cluster.placement import require_count
from equimesh_cluster.run import RunOptions, run_parts
from equimesh_cluster.worker_facts import examine_workers


def solve_blocks(
    problem: BlockProblem,
    client: Client | str,
    schwarz: BlockSchwarz | None = None,
    *,
    parts: int | None = None,
    threads: int = 1,
    observe: Callable[[dict[str, Any]], None] | None = None,
    cancel: Event | None = None,
) -> BlockSolution:
    """The mesh of ``problem``, with its subdomains on ``parts`` workers; equal to that of :func:`equimesh.solve`.

    ``client`` is a client of Dask, or the address of a scheduler. ``schwarz`` are the settings, by default one
    subdomain for each block. ``parts`` is by default one for each worker, and at most one for each subdomain; the mesh
    does not depend on it. ``threads`` share the subdomains of each part. ``observe`` is called with the numbers of
    every step; ``cancel`` ends the solve when it is set. Workers share the work on the finest mesh, and each of them
    holds the whole mesh.

    Raises :class:`~equimesh.errors.InputError` for more parts than subdomains or threads of the workers,
    :class:`~equimesh.solving.solution.SolveError` for a folded mesh, and the errors of :func:`equimesh_cluster.solve`.
    """
    if not isinstance(problem, BlockProblem):
        raise InputError(
            "the problem has no domain in blocks: give em.BlockProblem(...), or take equimesh_cluster.solve",
            field="problem",
        )
    settings, shared = schwarz or BlockSchwarz(), thread_count(threads)
    subdomains = count_subdomains(problem, settings)
    own = isinstance(client, str)
    connected = connect(client) if isinstance(client, str) else check_client(client)
    try:
        count = _count(connected, subdomains, parts)
        found = _run(problem, connected, settings, count, shared, RunOptions(observe=_telling(observe), cancel=cancel))
    finally:
        if own:
            connected.close()
    solution = found.solution(problem)
    if not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


def _count(client: Client, subdomains: int, parts: int | None) -> int:
    """The number of parts, for which there are subdomains."""
    if parts is None:
        return min(subdomains, max(1, len(examine_workers(client))))
    require_count(parts)
    if parts > subdomains:
        raise InputError(
            f"parts = {parts}: every part needs a subdomain, and there are {subdomains}: take fewer parts, or smaller"
            " groups of blocks",
            field="parts",
        )
    return parts


def _telling(observe: Callable[[dict[str, Any]], None] | None) -> Callable[[int, Any], None] | None:
    if observe is None:
        return None
    told = observe
    return lambda _, numbers: told(numbers)


def _run(
    problem: BlockProblem, client: Client, settings: BlockSchwarz, count: int, threads: int, options: RunOptions
) -> BlocksResult:
    """The result of the part that leads; nothing is left on the workers."""
    shared: list[Any] = []

    def arguments(number: int, _: int) -> tuple[Any, ...]:
        if number == 0:
            shared[:] = [sent(client, problem)]
        return shared[0], settings, threads, options.observe is not None

    run = run_parts(client, part_of_blocks, arguments, parts=count, options=options)
    found: BlocksResult = run.futures[0].result()
    for future in run.futures:
        future.release()
    return found


def part_of_blocks(
    channel: Any, problem: BlockProblem, settings: BlockSchwarz, threads: int, tells: bool
) -> BlocksResult | None:
    """One part of the solve. Runs on its worker."""

    def observe(event: Any) -> None:
        if isinstance(event, Descent):
            channel.report(plain(event))

    return solve_part_of_blocks(channel, problem, settings, threads=threads, observe=observe if tells else None)
