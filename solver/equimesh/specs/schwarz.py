"""Grids, targets and settings of the Schwarz iteration in a document."""

from collections.abc import Mapping
from typing import Any

from equimesh.errors import InputError
from equimesh.least_error.block_schwarz import BlockSchwarz
from equimesh.meshes.grid import Grid
from equimesh.schwarz.conditions import Classical, LinearRobin, NonlinearRobin, Optimized
from equimesh.schwarz.settings import Schwarz
from equimesh.solving.solve import NO_SUBDOMAINS
from equimesh.solving.target import MAX_POINTS, Target
from equimesh.specs.document import Makers, Reading, mapping, within
from equimesh_schema import mesh as mesh_schema
from equimesh_schema import schwarz as schema
from equimesh_schema.domains import DOMAINS

ON_BLOCKS = tuple(kind for kind, made in DOMAINS.documents.items() if made.HAS_BLOCKS)
"""The kinds of domains that have blocks."""
NO_TARGET = (
    "the subdomains of a Schwarz iteration are parts of a grid that is known: give a grid in place of the target"
)


def usual_grid(**given: int) -> Grid:
    """The grid of the numbers of points that are given, and the usual ones in place of others."""
    made = mesh_schema.Grid(**given)
    return Grid(n_xi=made.n_xi, n_eta=made.n_eta)


def _target(*, max_points: int | None = None, **given: Any) -> Target:
    return Target(**given, max_points=MAX_POINTS if max_points is None else max_points)


MAKERS: Makers = {
    mesh_schema.Grid: usual_grid,
    mesh_schema.Target: _target,
    schema.Schwarz: Schwarz,
    schema.BlockSchwarz: BlockSchwarz,
    schema.Optimized: Optimized,
    schema.Classical: Classical,
    schema.LinearRobin: LinearRobin,
    schema.NonlinearRobin: NonlinearRobin,
}
READING = Reading(MAKERS)


def block_schwarz(given: object) -> BlockSchwarz | None:
    """The settings of the iteration between the blocks of a domain, where those of a grid stand; None where null."""
    return None if given is None else READING.record(schema.BlockSchwarz, given, "schwarz")


def build_schwarz(document: object) -> Schwarz | None:
    """The Schwarz settings of a whole ``document``, which fit its grid; None for a single domain, and on blocks.

    Those of blocks are read, and need the domain to be compared with. Of the monitor it reads the kind alone.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``grid`` or ``schwarz``, also for a monitor
    that subdomains cannot solve.
    """
    given = mapping(document, "")
    domain = given.get("domain")
    settings = given.get("schwarz")
    if isinstance(domain, Mapping) and domain.get("kind") in ON_BLOCKS:
        block_schwarz(settings)
        return None
    if settings is None:
        return None
    schwarz: Schwarz = READING.record(schema.Schwarz, settings, "schwarz")
    monitor = given.get("monitor")
    if isinstance(monitor, Mapping) and monitor.get("kind") == "least_error":
        raise InputError(NO_SUBDOMAINS, field="schwarz")
    if given.get("target") is not None:
        raise InputError(NO_TARGET, field="target")
    grid = READING.record(mesh_schema.Grid, {} if given.get("grid") is None else given["grid"], "grid")
    with within("schwarz"):
        schwarz.decompose(grid)
    return schwarz
