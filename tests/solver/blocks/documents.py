"""Small descriptions for the tests of this folder."""

from __future__ import annotations

from typing import Any


def l_shape(**changes: Any) -> dict[str, Any]:
    """Three blocks around a re-entrant corner ``e``; counts and gradings spread from few entries."""
    return {
        "vertices": {
            "a": [0, 0],
            "b": [1, 0],
            "c": [2, 0],
            "d": [0, 1],
            "e": [1, 1],
            "f": [2, 1],
            "g": [0, 2],
            "h": [1, 2],
        },
        "blocks": [
            {"corners": ["a", "b", "e", "d"], "cells": [4, 5], "grading": [2, None]},
            {"corners": ["b", "c", "f", "e"], "cells": [3, None]},
            {"corners": ["d", "e", "h", "g"], "cells": [None, 6]},
        ],
        "sides": {"inlet": [["g", "d"], ["d", "a"]]},
    } | changes


def ring(**changes: Any) -> dict[str, Any]:
    """One block between two circles."""
    return {
        "vertices": {"i": [1, 0], "o": [2, 0]},
        "curves": {"inner": {"circle": {"radius": 1}}, "outer": {"circle": {"radius": 2}}},
        "edges": [{"from": "i", "to": "i", "on": "inner"}, {"from": "o", "to": "o", "on": "outer"}],
        "blocks": [{"corners": ["i", "o", "o", "i"], "cells": [4, 24]}],
        "sides": {"hole": [["i", "i"]]},
    } | changes


def channel(**changes: Any) -> dict[str, Any]:
    """Two blocks in a row, the ends joined, with a circular bump as the bottom of the first one."""
    return {
        "vertices": {"a": [0, 0], "b": [2, 0], "c": [3, 0], "d": [0, 1], "e": [2, 1], "f": [3, 1]},
        "curves": {"bump": {"circle": {"center": [1, -2], "radius": 5**0.5}}},
        "edges": [{"from": "a", "to": "b", "on": "bump"}],
        "blocks": [
            {"corners": ["a", "b", "e", "d"], "cells": [6, 4], "grading": [1, 3]},
            {"corners": ["b", "c", "f", "e"], "cells": [4, None]},
        ],
        "joins": [{"from": ["a", "d"], "to": ["c", "f"]}],
    } | changes
