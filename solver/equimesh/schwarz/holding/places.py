"""Rectangles of grid points: what two of them share, and the lines around a subdomain."""

from equimesh.schwarz.decomposition import AXES, ENDS, SubdomainWindow
from equimesh.schwarz.holding.port import Place


def common(one: Place, other: tuple[slice, ...]) -> Place | None:
    """The rectangle that two share; ``None`` where they share no point."""
    xi, eta = (slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return (xi, eta) if xi.start < xi.stop and eta.start < eta.stop else None


def points(place: Place | None) -> int:
    """The number of grid points of a rectangle."""
    return 0 if place is None else (place[0].stop - place[0].start) * (place[1].stop - place[1].start)


def moved(place: tuple[slice, ...], first: tuple[int, ...]) -> Place:
    """A rectangle of the grid as one of a window that begins at the grid point ``first``."""
    xi, eta = (slice(cut.start - start, cut.stop - start) for cut, start in zip(place, first, strict=True))
    return xi, eta


def rim(window: SubdomainWindow) -> dict[tuple[int, int], Place]:
    """The grid points of a window beyond its interfaces, by the step to the neighbour that covers them."""
    cuts = []
    for axis in AXES:
        covered = window.covered[axis]
        here = {0: covered}
        for end in ENDS:
            if window.open[axis, end]:
                beyond = slice(covered.stop, covered.stop + 1) if end else slice(covered.start - 1, covered.start)
                here[1 if end else -1] = beyond
        cuts.append(here)
    return {(i, j): (cuts[0][i], cuts[1][j]) for i in cuts[0] for j in cuts[1] if (i, j) != (0, 0)}
