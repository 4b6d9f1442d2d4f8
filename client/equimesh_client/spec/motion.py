"""How the mesh of a sequence moves."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, Literal, TypedDict


class Motion(TypedDict, total=False):
    """How the mesh of a sequence moves, from a step on. What is left out stays as it was."""

    smoothing: float
    """The share of the mesh before in each new mesh, from 0 (at first) to 0.9. Raise it where meshes jitter."""
    max_move: float
    """How far nodes may move in a step, in cells of the mesh before. At first: 1."""
    outrun: Literal["substeps", "refuse"]
    """What happens where nodes would move farther: ``"substeps"`` (at first) tries other starts, and meshes in between,
    where the error has risen; ``"refuse"`` raises :class:`MeshFailed`, and the sequence stays as it was.
    """


def motion_json(motion: Motion) -> dict[str, Any]:
    """The JSON of the settings; raises :class:`TypeError` for others, which names the nearest one."""
    given: Mapping[str, Any] = motion
    names = [*Motion.__annotations__]
    for name in given:
        if name not in names:
            nearest = get_close_matches(name, names, n=1)
            advice = f"did you mean {nearest[0]!r}?" if nearest else f"it has {', '.join(names)}"
            raise TypeError(f"step() has no option {name!r}; {advice}")
    return {name: value if isinstance(value, str) else float(value) for name, value in given.items()}
