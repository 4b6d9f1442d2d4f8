"""Work and traffic of one Schwarz iteration, counted."""

from collections.abc import Sequence

from equimesh.meshes.grid import Grid
from equimesh.schwarz.decomposition import Decomposition
from equimesh.schwarz.holding.places import common, points, rim
from equimesh.schwarz.port import Subdomains
from equimesh.schwarz.records import SubdomainRecord
from equimesh.schwarz.settings import Schwarz
from equimesh.schwarz.window import SubdomainWindow

BYTES_PER_NUMBER = 8
# Numbers that a line correction sends over an interface for every line that crosses it: the sum of the edges beyond,
# and how far the side of the grid at that end pushes the line.
NUMBERS_PER_CROSSING = 2


def work(grid: Grid, subdomains: Subdomains, records: Sequence[SubdomainRecord], corrections: int) -> int:
    """How many corrections of nodes there were."""
    nodes = [window.shape[0] * window.shape[1] for window in subdomains.windows]
    local = sum(nodes[r.subdomain] * max(r.sweeps, r.newton_steps) for r in records)
    return local + corrections * grid.points


def traffic(
    decomposition: Decomposition,
    settings: Schwarz,
    subdomains: Subdomains,
    turns: Sequence[Sequence[int]],
    corrections: int,
) -> int:
    """Bytes that the subdomains send each other, each on its own machine; ``corrections`` are those that were tried.

    Before its solve a subdomain receives the data of its interfaces. After a turn it receives the nodes of its window
    that others have solved. For every line correction it receives the grid lines beyond its interfaces, and numbers for
    each line that crosses them. Not counted are the few numbers on which all agree, whatever the size of the grid.
    """
    reads = windows_that_read(decomposition, settings)
    data = sum(subdomains.sent(turn) for turn in turns)
    nodes = sum(
        points(common(subdomains.place(k), window.slices))
        for turn in turns
        for k in turn
        for window in reads
        if window.part.number != k
    )
    return BYTES_PER_NUMBER * (data + 2 * nodes + corrections * _corrected(decomposition))


def windows_that_read(decomposition: Decomposition, settings: Schwarz) -> list[SubdomainWindow]:
    """The nodes of the merged mesh that every subdomain reads."""
    return [SubdomainWindow(decomposition, part, settings.ghosts) for part in decomposition.parts]


def _corrected(decomposition: Decomposition) -> int:
    """Numbers that all subdomains send in one line correction."""
    windows = [SubdomainWindow(decomposition, part, 1) for part in decomposition.parts]
    ghosts = sum(points(place) for window in windows for place in rim(window).values())
    lines = sum(window.shape[1 - axis] for window in windows for (axis, _), is_open in window.open.items() if is_open)
    return 2 * ghosts + NUMBERS_PER_CROSSING * lines
