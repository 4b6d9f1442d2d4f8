"""Domains that are meshes of blocks: a description, or the file of a mesh of quadrilaterals."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from equimesh_client.errors import BadArgument

Json: TypeAlias = dict[str, Any]
Box: TypeAlias = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """Blocks of quadrilaterals between named ``vertices``, on straight lines and ``curves``.

    The values are those of the JSON of the HTTP interface: ``curves`` are circles, points, profiles of airfoils or
    formulas by their names; ``edges`` say which curve an edge lies on; each of the ``blocks`` has four ``corners``,
    ``cells`` and ``grading``; ``joins`` are pairs of edges that are one by a translation; ``sides`` are lists of edges
    by their names; ``corners`` are vertices that stay where they are. ``refine`` multiplies all numbers of cells.
    """

    vertices: Mapping[str, Sequence[float]]
    blocks: Sequence[Mapping[str, Any]]
    curves: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    edges: Sequence[Mapping[str, Any]] = ()
    joins: Sequence[Mapping[str, Any]] = ()
    sides: Mapping[str, Sequence[Sequence[str]]] = field(default_factory=dict)
    corners: Sequence[str] = ()
    refine: int = 1

    def json(self) -> Json:
        """The JSON of the domain."""
        return {"kind": "blocks", **{one.name: _plain(getattr(self, one.name)) for one in fields(self)}}

    @property
    def box(self) -> Box | None:
        """None: only the service evaluates the curves."""
        return None

    @classmethod
    def read(cls, path: str | Path) -> Blocks:
        """The blocks of a JSON file; files of points that its curves name lie in the same folder.

        Raises :class:`BadArgument` for a file that holds no blocks, or that cannot be read.
        """
        path = Path(path)
        try:
            document = json.loads(path.read_bytes())
        except OSError as error:
            raise BadArgument(f"{path}: {error.strerror or error}") from error
        except ValueError as error:
            raise BadArgument(f"{path} is not JSON: {error}") from error
        return cls.of(document, folder=path.parent)

    @classmethod
    def of(cls, document: object, *, folder: Path | None = None) -> Blocks:
        """The blocks of a JSON document; with a ``folder`` its curves may name files of points there.

        Raises :class:`BadArgument` for another document.
        """
        if not isinstance(document, Mapping):
            raise BadArgument("a description of blocks is a JSON object with vertices and blocks")
        given = {name: value for name, value in document.items() if name != "kind"}
        known = {one.name: one for one in fields(cls)}
        unknown = [str(name) for name in given if name not in known]
        if unknown:
            raise BadArgument(f"a description of blocks has no {', '.join(unknown)}; it has {', '.join(known)}")
        needed = [name for name, one in known.items() if one.default is MISSING and one.default_factory is MISSING]
        missing = [name for name in needed if name not in given]
        if missing:
            raise BadArgument(f"a description of blocks needs {' and '.join(missing)}")
        if folder is not None and isinstance(given.get("curves"), Mapping):
            given["curves"] = {name: _with_points(curve, folder) for name, curve in given["curves"].items()}
        return cls(**given)


@dataclass(frozen=True, kw_only=True)
class MeshFile:
    """A mesh of quadrilaterals that is a domain: its ``file``, or the id of one that the service has.

    ``corners`` are nodes of the boundary that stay where they are: names of points in the file, numbers from 0, or
    places. So do nodes where sides meet, and those where the boundary turns by more than ``corner_angle`` degrees.
    """

    file: Path | str
    corners: Sequence[str | int | Sequence[float]] = ()
    corner_angle: float | None = None

    def json(self) -> Json:
        """The JSON of the domain."""
        return {
            "kind": "mesh",
            "file": str(self.file),
            "corners": _plain(self.corners),
            "corner_angle": self.corner_angle,
        }

    @property
    def box(self) -> Box | None:
        """None: only the service reads the file."""
        return None

    @property
    def is_local(self) -> bool:
        """Whether the file is on this machine, not at the service."""
        return isinstance(self.file, Path)


def _with_points(curve: object, folder: Path) -> Any:
    """The curve with the points of the file that it names."""
    points = curve.get("points") if isinstance(curve, Mapping) else None
    if not isinstance(curve, Mapping) or not isinstance(points, str):
        return curve
    return {**curve, "points": _points_in(folder / points)}


def _points_in(file: Path) -> list[list[float]]:
    """The points of a file, one x, y a line; lines before the first one are titles."""
    try:
        lines = file.read_text().splitlines()
    except OSError as error:
        raise BadArgument(f"{file}: {error.strerror or error}") from error
    found: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        try:
            x, y = map(float, words)
        except ValueError:
            if words and found:
                raise BadArgument(f"{file}, line {number}: {line.strip()[:60]!r} is no pair of numbers") from None
            continue
        found.append([x, y])
    if not found:
        raise BadArgument(f"{file} holds no points, one x, y a line")
    return found


def _plain(value: Any) -> Any:
    """Lists and dictionaries in place of tuples, arrays and other mappings."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value
