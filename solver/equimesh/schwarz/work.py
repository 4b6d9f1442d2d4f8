"""Work and traffic of one Schwarz iteration, counted."""

from collections.abc import Sequence

from equimesh.meshes.grid import Grid
from equimesh.schwarz.port import Subdomains
from equimesh.schwarz.records import SubdomainRecord
from equimesh.schwarz.settings import Schwarz

BYTES_PER_NUMBER = 8
# Numbers that one line correction sends over a cut for every line that crosses it: the nodes next to the cut on both
# sides, and the sum of the line in both directions.
NUMBERS_PER_CROSSING = 6


def work(grid: Grid, subdomains: Subdomains, records: Sequence[SubdomainRecord], corrections: int) -> int:
    """How many corrections of nodes there were."""
    nodes = [window.shape[0] * window.shape[1] for window in subdomains.windows]
    local = sum(nodes[r.subdomain] * max(r.sweeps, r.newton_steps) for r in records)
    return local + corrections * grid.points


def traffic(
    grid: Grid, settings: Schwarz, subdomains: Subdomains, turns: Sequence[Sequence[int]], corrections: int
) -> int:
    """Bytes that the subdomains would send each other if each had its own machine."""
    columns, rows = settings.subdomains
    crossings = (columns - 1) * grid.n_eta + (rows - 1) * grid.n_xi
    exchanged = sum(subdomains.sent(k) for turn in turns for k in turn)
    return BYTES_PER_NUMBER * (exchanged + NUMBERS_PER_CROSSING * crossings * corrections)
