"""Settings of the Schwarz iteration in a document."""

from collections.abc import Mapping

from equimesh.errors import InputError
from equimesh.least_error.block_schwarz import BlockSchwarz
from equimesh.schwarz.conditions import Classical, LinearRobin, NonlinearRobin, Optimized, TransmissionCondition
from equimesh.schwarz.settings import Schwarz
from equimesh.solving.solve import NO_SUBDOMAINS
from equimesh.solving.target import MAX_POINTS, Target
from equimesh.specs.document import (
    ByKind,
    Record,
    as_given,
    either,
    flag,
    mapping,
    number,
    optional,
    whole,
    within,
)
from equimesh.specs.domains import GRID


def _pair(value: object, path: str) -> object:
    """A list of JSON as a tuple, also inside; the settings check the rest."""
    return tuple(_pair(part, path) for part in value) if isinstance(value, list) else value


def _limit(value: object, path: str) -> int:
    """A number of points; null stands for the default."""
    return MAX_POINTS if value is None else whole(value, path)


TRANSMISSION: ByKind[TransmissionCondition] = ByKind(
    {
        "optimized": Record(Optimized, {"data": as_given}),
        "classical": Record(Classical, {}),
        "linear_robin": Record(LinearRobin, {"p": either("auto", number)}),
        "nonlinear_robin": Record(NonlinearRobin, {"p": either("auto", number)}),
    }
)
_SETTINGS = Record(
    Schwarz,
    {
        "subdomains": _pair,
        "overlap": as_given,
        "transmission": TRANSMISSION,
        "ordering": as_given,
        "line_correction": as_given,
        "acceleration": as_given,
        "local_solver": as_given,
        "fallback": flag,
        "tolerance": either("discretization", optional(number)),
        "max_iterations": as_given,
        "compare_single_domain": flag,
    },
)
SCHWARZ = optional(_SETTINGS)
BLOCK_SCHWARZ = optional(
    Record(BlockSchwarz, dict.fromkeys(("overlap", "local_steps", "max_exchanges", "groups"), as_given))
)
"""The settings of the iteration between the blocks of a domain, where those of a grid stand."""
ON_BLOCKS = ("blocks", "mesh")
"""The kinds of domains that have blocks."""
TARGET = Record(Target, {"norm": as_given, "error": number, "max_points": _limit})
NO_TARGET = (
    "the subdomains of a Schwarz iteration are parts of a grid that is known: give a grid in place of the target"
)


def build_schwarz(document: object) -> Schwarz | None:
    """The Schwarz settings of a whole ``document``, which fit its grid; None for a single domain, and on blocks.

    Those of blocks are read, and need the domain to be compared with. Of the monitor it reads the kind alone.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``grid`` or ``schwarz``, also for a monitor
    that subdomains cannot solve.
    """
    given = mapping(document, "")
    domain = given.get("domain")
    if isinstance(domain, Mapping) and domain.get("kind") in ON_BLOCKS:
        BLOCK_SCHWARZ(given.get("schwarz"), "schwarz")
        return None
    schwarz: Schwarz | None = SCHWARZ(given.get("schwarz"), "schwarz")
    if schwarz is None:
        return None
    monitor = given.get("monitor")
    if isinstance(monitor, Mapping) and monitor.get("kind") == "least_error":
        raise InputError(NO_SUBDOMAINS, field="schwarz")
    if given.get("target") is not None:
        raise InputError(NO_TARGET, field="target")
    grid = GRID({} if given.get("grid") is None else given["grid"], "grid")
    with within("schwarz"):
        schwarz.decompose(grid)
    return schwarz
