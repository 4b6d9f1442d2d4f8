"""Ten domains of blocks, as descriptions: what people compute on.

Each function returns the :class:`~equimesh.blocks.blocks.Blocks` of its domain with about ``nodes`` nodes;
``DESCRIPTIONS`` has the documents themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description

# Nodes of a geometry, unless given.
NODES = 12_000


def l_shape(nodes: int = NODES) -> Blocks:
    """The square from -1 to 1 without its quarter on the lower right: three blocks, one re-entrant corner."""
    return with_nodes(L_SHAPE, nodes)


def step(nodes: int = NODES) -> Blocks:
    """A channel with a backward step of half its height: three blocks."""
    return with_nodes(STEP, nodes)


def obstacle(nodes: int = NODES) -> Blocks:
    """A channel around a square obstacle: eight blocks, four re-entrant corners."""
    return with_nodes(OBSTACLE, nodes)


def plus(nodes: int = NODES) -> Blocks:
    """Two crossing bars: five blocks, four re-entrant corners."""
    return with_nodes(PLUS, nodes)


def ring(nodes: int = NODES) -> Blocks:
    """The points between two circles: one block that closes around the hole."""
    return with_nodes(RING, nodes)


def disc(nodes: int = NODES) -> Blocks:
    """The unit disc: a square inside and four blocks around it, with four nodes of three cells."""
    return with_nodes(DISC, nodes)


def cylinder(nodes: int = NODES) -> Blocks:
    """A circular cylinder in a channel: four blocks around it, eight between them and the walls."""
    return with_nodes(CYLINDER, nodes)


def naca0012_o(nodes: int = NODES) -> Blocks:
    """The profile NACA 0012 in a circle: one block that closes around it, an O-grid."""
    return with_nodes(NACA0012_O, nodes)


def naca0012_c(nodes: int = NODES) -> Blocks:
    """The profile NACA 0012 and its wake: three blocks, a C-grid."""
    return with_nodes(NACA0012_C, nodes)


def pitz_daily(nodes: int = NODES) -> Blocks:
    """The combustor of Pitz and Daily (1983), in millimetres: five blocks with cells that grow away from the step.

    The vertices are those of the tutorial of OpenFOAM with this name.
    """
    return with_nodes(PITZ_DAILY, nodes)


def with_nodes(document: dict[str, Any], nodes: int) -> Blocks:
    """The domain of a description, whose counts are multiplied such that it has about so many nodes."""
    now = plan_of(Description.of(document)).layout.node_count
    return Blocks.of(document | {"refine": math.sqrt(nodes / now)})


L_SHAPE: dict[str, Any] = {
    "vertices": {
        "sw": [-1, -1],
        "s": [0, -1],
        "w": [-1, 0],
        "corner": [0, 0],
        "e": [1, 0],
        "nw": [-1, 1],
        "n": [0, 1],
        "ne": [1, 1],
    },
    "blocks": [
        {"name": "lower", "corners": ["sw", "s", "corner", "w"], "cells": [64, 64]},
        {"name": "upper_left", "corners": ["w", "corner", "n", "nw"], "cells": [64, 64]},
        {"name": "upper_right", "corners": ["corner", "e", "ne", "n"], "cells": [64, 64]},
    ],
    "sides": {"reentrant": [["s", "corner"], ["corner", "e"]]},
}

STEP: dict[str, Any] = {
    "vertices": {
        "inlet_low": [-1, 0],
        "edge": [0, 0],
        "foot": [0, -0.5],
        "outlet_low": [4, -0.5],
        "outlet_middle": [4, 0],
        "outlet_high": [4, 0.5],
        "above": [0, 0.5],
        "inlet_high": [-1, 0.5],
    },
    "blocks": [
        {"name": "inlet", "corners": ["inlet_low", "edge", "above", "inlet_high"], "cells": [40, 40]},
        {"name": "upper", "corners": ["edge", "outlet_middle", "outlet_high", "above"], "cells": [120, 40]},
        {"name": "lower", "corners": ["foot", "outlet_low", "outlet_middle", "edge"], "cells": [120, 40]},
    ],
    "sides": {
        "inlet": [["inlet_high", "inlet_low"]],
        "outlet": [["outlet_low", "outlet_middle"], ["outlet_middle", "outlet_high"]],
        "step": [["inlet_low", "edge"], ["edge", "foot"], ["foot", "outlet_low"]],
        "top": [["outlet_high", "above"], ["above", "inlet_high"]],
    },
}


def _lattice(xs: list[float], ys: list[float]) -> dict[str, list[float]]:
    """The vertices of a lattice; ``p21`` is the one at ``xs[2]`` and ``ys[1]``."""
    return {f"p{i}{j}": [x, y] for i, x in enumerate(xs) for j, y in enumerate(ys)}


def _cell(i: int, j: int, cells: tuple[int, int]) -> dict[str, Any]:
    """The block of a lattice whose first corner is ``p<i><j>``."""
    corners = [f"p{i}{j}", f"p{i + 1}{j}", f"p{i + 1}{j + 1}", f"p{i}{j + 1}"]
    return {"name": f"b{i}{j}", "corners": corners, "cells": list(cells)}


_AROUND = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]

OBSTACLE: dict[str, Any] = {
    "vertices": _lattice([0, 1, 1.5, 4], [0, 0.75, 1.25, 2]),
    "blocks": [_cell(i, j, ((40, 24, 80)[i], (32, 24, 32)[j])) for i, j in _AROUND],
    "sides": {
        "inlet": [["p00", "p01"], ["p01", "p02"], ["p02", "p03"]],
        "outlet": [["p30", "p31"], ["p31", "p32"], ["p32", "p33"]],
        "bottom": [["p00", "p10"], ["p10", "p20"], ["p20", "p30"]],
        "top": [["p03", "p13"], ["p13", "p23"], ["p23", "p33"]],
        "obstacle": [["p11", "p12"], ["p12", "p22"], ["p22", "p21"], ["p21", "p11"]],
    },
}

_PLUS = [(1, 0), (0, 1), (1, 1), (2, 1), (1, 2)]

PLUS: dict[str, Any] = {
    "vertices": {
        name: place
        for name, place in _lattice([-1.5, -0.5, 0.5, 1.5], [-1.5, -0.5, 0.5, 1.5]).items()
        if name not in ("p00", "p30", "p03", "p33")
    },
    "blocks": [_cell(i, j, (48, 48)) for i, j in _PLUS],
    "sides": {
        "south": [["p10", "p20"]],
        "east": [["p31", "p32"]],
        "north": [["p13", "p23"]],
        "west": [["p01", "p02"]],
    },
}

RING: dict[str, Any] = {
    "vertices": {"inner": [1, 0], "outer": [2, 0]},
    "curves": {"hole": {"circle": {"radius": 1}}, "rim": {"circle": {"radius": 2}}},
    "edges": [{"from": "inner", "to": "inner", "on": "hole"}, {"from": "outer", "to": "outer", "on": "rim"}],
    "blocks": [{"name": "ring", "corners": ["inner", "outer", "outer", "inner"], "cells": [36, 324]}],
    "sides": {"hole": [["inner", "inner"]], "rim": [["outer", "outer"]]},
}

_QUARTERS = [(0, 1), (1, 2), (2, 3), (3, 0)]
_DIAGONALS = [(-1, -1), (1, -1), (1, 1), (-1, 1)]

DISC: dict[str, Any] = {
    "vertices": {
        **{f"c{k}": [0.42 * x, 0.42 * y] for k, (x, y) in enumerate(_DIAGONALS)},
        **{f"r{k}": [x * math.sqrt(0.5), y * math.sqrt(0.5)] for k, (x, y) in enumerate(_DIAGONALS)},
    },
    "curves": {"rim": {"circle": {"radius": 1}}},
    "edges": [{"from": f"r{a}", "to": f"r{b}", "on": "rim"} for a, b in _QUARTERS],
    "blocks": [
        {"name": "middle", "corners": ["c0", "c1", "c2", "c3"], "cells": [48, 48]},
        *(
            {"name": f"outer{a}", "corners": [f"c{a}", f"r{a}", f"r{b}", f"c{b}"], "cells": [48, None]}
            for a, b in _QUARTERS
        ),
    ],
    "sides": {"rim": [[f"r{a}", f"r{b}"] for a, b in _QUARTERS]},
}

_CORNERS = ["p11", "p21", "p22", "p12"]  # of the square around the cylinder, counter-clockwise from the lower left

CYLINDER: dict[str, Any] = {
    "vertices": {
        **_lattice([-2.5, -1, 1, 6], [-2, -1, 1, 2]),
        **{f"c{k}": [0.5 * x * math.sqrt(0.5), 0.5 * y * math.sqrt(0.5)] for k, (x, y) in enumerate(_DIAGONALS)},
    },
    "curves": {"cylinder": {"circle": {"radius": 0.5}}},
    "edges": [{"from": f"c{a}", "to": f"c{b}", "on": "cylinder"} for a, b in _QUARTERS],
    "blocks": [
        *(
            {"name": f"around{a}", "corners": [f"c{a}", _CORNERS[a], _CORNERS[b], f"c{b}"], "cells": [24, 40]}
            for a, b in _QUARTERS
        ),
        *(_cell(i, j, ((30, 40, 96)[i], (20, 40, 20)[j])) for i, j in _AROUND),
    ],
    "sides": {
        "inlet": [["p00", "p01"], ["p01", "p02"], ["p02", "p03"]],
        "outlet": [["p30", "p31"], ["p31", "p32"], ["p32", "p33"]],
        "bottom": [["p00", "p10"], ["p10", "p20"], ["p20", "p30"]],
        "top": [["p03", "p13"], ["p13", "p23"], ["p23", "p33"]],
        "cylinder": [[f"c{a}", f"c{b}"] for a, b in _QUARTERS],
    },
}

# Cells are small at both edges of the profile, on the upper and on the lower side.
_PROFILE = [[1, 1, 12], [1, 1, 0.2], [1, 1, 5], [1, 1, 1 / 12]]

NACA0012_O: dict[str, Any] = {
    "vertices": {"te": [1, 0], "far": [4.5, 0]},
    "curves": {"foil": {"naca": "0012"}, "far": {"circle": {"center": [0.5, 0], "radius": 4}}},
    "edges": [
        {"from": "te", "to": "te", "on": "foil", "grading": _PROFILE},
        {"from": "far", "to": "far", "on": "far", "grading": 1},
    ],
    "blocks": [{"name": "around", "corners": ["te", "far", "far", "te"], "cells": [72, 256], "grading": [60, None]}],
    "sides": {"foil": [["te", "te"]], "far": [["far", "far"]]},
}

NACA0012_C: dict[str, Any] = {
    "vertices": {
        "te": [1, 0],
        "out": [5, 0],
        "top": [1, 3],
        "bottom": [1, -3],
        "out_top": [5, 3],
        "out_bottom": [5, -3],
    },
    "curves": {"foil": {"naca": "0012"}, "front": {"circle": {"center": [1, 0], "radius": 3}}},
    "edges": [
        {"from": "te", "to": "te", "on": "foil", "grading": _PROFILE},
        {"from": "top", "to": "bottom", "on": "front", "via": [-2, 0], "grading": 1},
    ],
    "blocks": [
        {"name": "around", "corners": ["te", "top", "bottom", "te"], "cells": [60, 200], "grading": [60, None]},
        {"name": "above", "corners": ["te", "out", "out_top", "top"], "cells": [64, None], "grading": [40, None]},
        {"name": "below", "corners": ["bottom", "out_bottom", "out", "te"], "cells": [64, None]},
    ],
    "sides": {
        "foil": [["te", "te"]],
        "far": [["out_top", "top"], ["top", "bottom"], ["bottom", "out_bottom"]],
        "outlet": [["out_bottom", "out"], ["out", "out_top"]],
    },
}

# Cells are small next to the shear layer that leaves the step.
_ABOVE = [[1, 2, 4], [1, 1, 0.5]]
_BELOW = [[2, 1, 1], [1, 1, 0.25]]

PITZ_DAILY: dict[str, Any] = {
    "vertices": {
        "v0": [-20.6, 0],
        "v1": [-20.6, 25.4],
        "v2": [0, -25.4],
        "v3": [0, 0],
        "v4": [0, 25.4],
        "v5": [206, -25.4],
        "v6": [206, 0],
        "v7": [206, 25.4],
        "v8": [290, -16.6],
        "v9": [290, 0],
        "v10": [290, 16.6],
    },
    "blocks": [
        {"name": "inlet", "corners": ["v0", "v3", "v4", "v1"], "cells": [18, 30], "grading": [0.4, _ABOVE]},
        {"name": "lower", "corners": ["v2", "v5", "v6", "v3"], "cells": [180, 27], "grading": [4, _BELOW]},
        {"name": "upper", "corners": ["v3", "v6", "v7", "v4"], "cells": [180, 30], "grading": [4, None]},
        {"name": "lower_outlet", "corners": ["v5", "v8", "v9", "v6"], "cells": [25, 27], "grading": [2, None]},
        {"name": "upper_outlet", "corners": ["v6", "v9", "v10", "v7"], "cells": [25, 30], "grading": [2, None]},
    ],
    "sides": {
        "inlet": [["v0", "v1"]],
        "outlet": [["v8", "v9"], ["v9", "v10"]],
        "lower_wall": [["v0", "v3"], ["v3", "v2"], ["v2", "v5"], ["v5", "v8"]],
        "upper_wall": [["v1", "v4"], ["v4", "v7"], ["v7", "v10"]],
    },
}

GEOMETRIES: dict[str, Callable[..., Blocks]] = {
    function.__name__: function
    for function in (l_shape, step, obstacle, plus, ring, disc, cylinder, naca0012_o, naca0012_c, pitz_daily)
}
"""The ten functions by their names."""

DESCRIPTIONS: dict[str, dict[str, Any]] = {
    "l_shape": L_SHAPE,
    "step": STEP,
    "obstacle": OBSTACLE,
    "plus": PLUS,
    "ring": RING,
    "disc": DISC,
    "cylinder": CYLINDER,
    "naca0012_o": NACA0012_O,
    "naca0012_c": NACA0012_C,
    "pitz_daily": PITZ_DAILY,
}
"""The descriptions by the same names."""
