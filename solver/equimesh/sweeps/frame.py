"""The kind of the four sides of a window of the grid, for the line corrections."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The kind of the four sides of a window, by direction (0 across xi, 1 across eta) and end.

    A side is ``physical``, or its outermost grid line is held in place. A held side *yields* if edges of the whole grid
    lie ``beyond`` it: the lines that cross it then end on the line before it, and these ends move, since the edges
    outside share the metric length of the line. A held side without edges beyond is fixed.

    Lines of a ``closed`` direction have no ends. The outermost grid lines are then copies of the nodes on the other
    side, moved by 1: the nodes in between are all nodes of the line, once each.
    """

    physical: tuple[tuple[bool, bool], tuple[bool, bool]] = ((True, True), (True, True))
    beyond: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    closed: tuple[bool, bool] = (False, False)

    @classmethod
    def around(cls, closed: tuple[bool, bool]) -> Frame:
        """The whole grid with lines that are closed, and physical sides in the other directions."""
        return cls(physical=((not closed[0],) * 2, (not closed[1],) * 2), closed=closed)

    def span(self, axis: int, points: int) -> tuple[int, int]:
        """First and last node of the lines along a direction, in a window of ``points`` points."""
        if self.closed[axis]:
            return 1, points - 1
        lower, upper = self.beyond[axis]
        return int(lower > 0), points - 1 - int(upper > 0)


WHOLE = Frame()
"""The whole grid: four physical sides."""
