"""How the four sides of a window of the grid are closed, for the line corrections."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The kind of the four sides of a window, by direction (0 across xi, 1 across eta) and end.

    A side is ``physical``, or its outermost grid line is held where it is. Of the latter, one with edges of the whole
    grid ``beyond`` it *yields*: the lines that cross it end on the line before it, and what lies outside takes up
    metric length with them, as a whole, so that the lines' ends move. One with none beyond is fixed.
    """

    physical: tuple[tuple[bool, bool], tuple[bool, bool]] = ((True, True), (True, True))
    beyond: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))

    def span(self, axis: int, points: int) -> tuple[int, int]:
        """First and last node of the lines along a direction, in a window of ``points`` points."""
        lower, upper = self.beyond[axis]
        return int(lower > 0), points - 1 - int(upper > 0)


WHOLE = Frame()
"""The whole grid: four physical sides."""
