"""The description of a domain of blocks: from JSON to checked records."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from equimesh.blocks.curve_entries import (
    curve_of,
    entries,
    mapping,
    members,
    name_among,
    named,
    number,
    place,
    point,
    whole,
    with_points,
)
from equimesh.blocks.curves import BoundaryCurve, Point
from equimesh.blocks.grading import Grading, grading_of
from equimesh.errors import InputError
from equimesh.inputs import check_name
from equimesh.io.reading.plain_mesh import MAX_EDGES, check_side_count

# Cells along one edge.
MAX_CELLS = 100_000
# Blocks of one domain.
MAX_BLOCKS = 10_000
# The members of a description.
MEMBERS = ("kind", "vertices", "curves", "edges", "blocks", "joins", "sides", "corners", "fixed", "refine")

Ends: TypeAlias = tuple[str, str]
"""The names of the vertices at which an edge begins and ends."""


@dataclass(frozen=True, kw_only=True)
class EdgeEntry:
    """An entry of ``edges``: the curve that an edge lies on, its cells and its grading; ``field`` is for messages."""

    ends: Ends
    on: str | None
    via: Point | None
    cells: int | None
    grading: Grading | None
    field: str


@dataclass(frozen=True, kw_only=True)
class BlockEntry:
    """An entry of ``blocks``: four corners counter-clockwise, cells along i and j, and gradings.

    Those are of left, right, bottom and top. i runs from the first corner to the second one, j from
    the first to the fourth.
    """

    name: str
    corners: tuple[str, str, str, str]
    cells: tuple[int | None, int | None]
    gradings: tuple[Grading | None, ...]
    field: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Description:
    """A checked description; ``document`` is its JSON, with the points of files in it."""

    document: Mapping[str, Any]
    vertices: Mapping[str, Point]
    curves: Mapping[str, BoundaryCurve]
    edges: tuple[EdgeEntry, ...]
    blocks: tuple[BlockEntry, ...]
    joins: tuple[tuple[Ends, Ends], ...]
    sides: Mapping[str, tuple[Ends, ...]]
    corners: tuple[str, ...]
    fixed: tuple[Ends, ...]
    refine: float

    @classmethod
    def of(cls, document: object, folder: Path | None = None) -> Description:
        """The records of a document, whose files of points lie in ``folder``.

        Raises :class:`~equimesh.errors.InputError` with the path of the first bad entry, such as
        ``domain.blocks[2].cells``.
        """
        given = dict(members(document, "domain", MEMBERS))
        if given.get("kind", "blocks") != "blocks":
            raise InputError(
                f"kind = {given['kind']!r}: a description of blocks has the kind blocks", field="domain.kind"
            )
        if "curves" in given:
            given["curves"] = with_points(named(given["curves"], "domain.curves", "a curve"), folder)
        vertices = {
            name: point(value, f"domain.vertices.{name}")
            for name, value in named(given.get("vertices"), "domain.vertices", "a vertex").items()
        }
        curves = {
            name: curve_of(value, f"domain.curves.{name}")
            for name, value in mapping(given.get("curves", {}), "domain.curves").items()
        }
        listed = {
            name: entries(given.get(name, ()), f"domain.{name}")
            for name in ("edges", "blocks", "joins", "corners", "fixed")
        }
        if not 1 <= len(listed["blocks"]) <= MAX_BLOCKS:
            message = f"blocks has {len(listed['blocks'])} entries: 1 to {MAX_BLOCKS} are possible"
            raise InputError(message, field="domain.blocks")
        refine = number(given.get("refine", 1), "domain.refine", positive=True)
        return cls(
            vertices=vertices,
            curves=curves,
            edges=tuple(_edge(entry, k, vertices, curves) for k, entry in enumerate(listed["edges"])),
            blocks=tuple(_block(entry, k, vertices) for k, entry in enumerate(listed["blocks"])),
            joins=tuple(_join(entry, k, vertices) for k, entry in enumerate(listed["joins"])),
            sides=_sides(given.get("sides", {}), vertices, MAX_EDGES * len(listed["blocks"])),
            corners=tuple(
                name_among(name, f"domain.corners[{k}]", vertices, "vertex") for k, name in enumerate(listed["corners"])
            ),
            fixed=tuple(_ends(ends, f"domain.fixed[{k}]", vertices) for k, ends in enumerate(listed["fixed"])),
            refine=refine,
            document=copy.deepcopy(given),  # the last: entries that are read are not nested deeply
        )


def _edge(value: object, k: int, vertices: Mapping[str, Point], curves: Mapping[str, BoundaryCurve]) -> EdgeEntry:
    field = f"domain.edges[{k}]"
    entry = members(value, field, ("from", "to", "on", "via", "cells", "grading"))
    return EdgeEntry(
        ends=(
            name_among(entry.get("from"), f"{field}.from", vertices, "vertex"),
            name_among(entry.get("to"), f"{field}.to", vertices, "vertex"),
        ),
        on=name_among(entry["on"], f"{field}.on", curves, "curve") if "on" in entry else None,
        via=point(entry["via"], f"{field}.via") if "via" in entry else None,
        cells=whole(entry["cells"], f"{field}.cells", MAX_CELLS) if "cells" in entry else None,
        grading=grading_of(entry["grading"], f"{field}.grading") if "grading" in entry else None,
        field=field,
    )


def _block(value: object, k: int, vertices: Mapping[str, Point]) -> BlockEntry:
    field = f"domain.blocks[{k}]"
    entry = members(value, field, ("name", "corners", "cells", "grading"))
    names = entries(entry.get("corners"), f"{field}.corners", count=4)
    a, b, c, d = (name_among(name, f"{field}.corners[{n}]", vertices, "vertex") for n, name in enumerate(names))
    given = entries(entry.get("cells", (None, None)), f"{field}.cells", count=2)
    cells = tuple(None if n is None else whole(n, f"{field}.cells[{i}]", MAX_CELLS) for i, n in enumerate(given))
    name = entry.get("name", f"block{k}")
    if not isinstance(name, str) or not name:
        raise InputError(f"{place(field)}.name must be a text", field=f"{field}.name")
    check_name(name, place(field), f"{field}.name")
    gradings = _gradings(entry.get("grading", (None, None)), f"{field}.grading")
    return BlockEntry(name=name, corners=(a, b, c, d), cells=(cells[0], cells[1]), gradings=gradings, field=field)


def _gradings(value: object, field: str) -> tuple[Grading | None, ...]:
    """The gradings of left, right, bottom and top, from those along i and j, or from those of four edges."""
    given = entries(value, field)
    if len(given) not in (2, 4):
        raise InputError(
            f"{place(field)} has {len(given)} entries: it must have 2, along i and j, or 4, along i at both ends of j"
            " and along j at both ends of i",
            field=field,
        )
    found = [None if entry is None else grading_of(entry, f"{field}[{k}]") for k, entry in enumerate(given)]
    if len(found) == 2:
        along_i, along_j = found
        return along_j, along_j, along_i, along_i
    bottom, top, left, right = found
    return left, right, bottom, top


def _join(value: object, k: int, vertices: Mapping[str, Point]) -> tuple[Ends, Ends]:
    field = f"domain.joins[{k}]"
    entry = members(value, field, ("from", "to"))
    return _ends(entry.get("from"), f"{field}.from", vertices), _ends(entry.get("to"), f"{field}.to", vertices)


def _sides(value: object, vertices: Mapping[str, Point], most_edges: int) -> dict[str, tuple[Ends, ...]]:
    found, count = {}, 0
    check_side_count(len(mapping(value, "domain.sides")), "domain.sides")
    for name, edges in named(value, "domain.sides", "a side").items():
        field = f"domain.sides.{name}"
        if not name.strip():
            raise InputError("sides has an empty name", field="domain.sides")
        listed = entries(edges, field)
        count += len(listed)
        if count > most_edges:
            message = f"sides have more than {most_edges} edges, too many for the blocks: name each edge once"
            raise InputError(message, field="domain.sides")
        found[name] = tuple(_ends(ends, f"{field}[{k}]", vertices) for k, ends in enumerate(listed))
    return found


def _ends(value: object, field: str, vertices: Mapping[str, Point]) -> Ends:
    first, last = entries(value, field, count=2, what="a list of two vertices")
    return name_among(first, f"{field}[0]", vertices, "vertex"), name_among(last, f"{field}[1]", vertices, "vertex")
