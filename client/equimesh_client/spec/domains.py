"""Physical domains: their JSON, the boxes around them, and files of blocks."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args, get_origin

import numpy as np

from equimesh_client.errors import BadArgument
from equimesh_coupling.samples import Box
from equimesh_schema import domains
from equimesh_schema.document import Pair, keys_of, one_of, required_of, types_of
from equimesh_schema.domains import (
    CURVES,
    DOMAINS,
    AnnulusSector,
    AnyDomain,
    DomainDocument,
    FixedRectangle,
    MeshFile,
    Rectangle,
)

Json: TypeAlias = dict[str, Any]
Domain: TypeAlias = AnyDomain


@dataclass(frozen=True, kw_only=True)
class Blocks(domains.Blocks):
    """Blocks of quadrilaterals between named ``vertices``, on straight lines and ``curves``.

    The values are those of the JSON of the HTTP interface: ``curves`` are circles, points, profiles of airfoils or
    formulas by their names; ``edges`` say which curve an edge lies on; each of the ``blocks`` has four ``corners``,
    ``cells`` and ``grading``; ``joins`` are pairs of edges that are one by a translation; ``sides`` are lists of edges
    by their names; ``corners`` are vertices that stay where they are. ``refine`` multiplies all numbers of cells.
    """

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
        known = [name for name in keys_of(cls) if name != "kind"]
        unknown = [str(name) for name in given if name not in known]
        if unknown:
            raise BadArgument(f"a description of blocks has no {', '.join(unknown)}; it has {', '.join(known)}")
        missing = [name for name in required_of(cls) if name in known and name not in given]
        if missing:
            raise BadArgument(f"a description of blocks needs {' and '.join(missing)}")
        if folder is not None and isinstance(given.get("curves"), Mapping):
            given["curves"] = {name: _with_points(curve, folder) for name, curve in given["curves"].items()}
        return cls(**given)


def _require_document(domain: object) -> DomainDocument:
    """The domain; raises :class:`BadArgument` for anything else."""
    if not isinstance(domain, DomainDocument):
        kinds = "a Rectangle, AnnulusSector, Quadrilateral, Blocks, FixedRectangle or MeshFile"
        raise BadArgument(f"a domain is {kinds} of equimesh_client, or its JSON; not {domain!r:.80}")
    return domain


def domain_json(domain: object) -> Json:
    """The JSON of a domain; a mapping is such JSON already."""
    if isinstance(domain, Mapping):
        return dict(domain)
    domain = _require_document(domain)
    checked = {name: _json_of(name, kind, domain) for name, kind in types_of(type(domain)).items()}
    return {**domain.to_json(), **{name: value for name, value in checked.items() if value is not None}}


def has_own_points(domain: Domain | Mapping[str, Any] | None) -> bool:
    """Whether the points of a mesh are those of its domain, as of blocks, which no grid is given for."""
    if isinstance(domain, Mapping):
        made = DOMAINS.documents.get(domain.get("kind", DOMAINS.default))
        return made is not None and made.HAS_BLOCKS
    return domain is not None and _require_document(domain).HAS_BLOCKS


def box_around(domain: Domain | Mapping[str, Any]) -> Box | None:
    """The smallest box around a domain; None where only the service evaluates its curves, or reads its file."""
    domain = read_domain(domain) if isinstance(domain, Mapping) else domain
    if isinstance(domain, Rectangle | FixedRectangle):
        (x0, x1), (y0, y1) = _pair("x", domain.x), _pair("y", domain.y)
        return (x0, x1), (y0, y1)
    return _box_of_sector(domain) if isinstance(domain, AnnulusSector) else None


def _box_of_sector(domain: AnnulusSector) -> Box:
    """The box of the corners, and of the outer arc where it crosses a direction of the axes."""
    (first, last), radii, center = _pair("angles", domain.angles), _pair("radii", domain.radii), domain.center
    quarters = range(math.ceil(first / 90.0), math.floor(last / 90.0) + 1)
    ends = [(r, _direction(angle)) for r in radii for angle in (first, last)]
    ends += [(radii[1], _direction(90.0 * quarter)) for quarter in quarters]
    box = [(c + min(r * d[k] for r, d in ends), c + max(r * d[k] for r, d in ends)) for k, c in enumerate(center)]
    return box[0], box[1]


def _direction(degrees: float) -> Sequence[float]:
    """Cosine and sine, exact at multiples of a right angle."""
    quarter, rest = divmod(degrees, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    return math.cos(math.radians(degrees)), math.sin(math.radians(degrees))


def read_domain(document: object) -> Domain:
    """The domain of a JSON document of the HTTP interface; raises :class:`BadArgument` for another document."""
    if not isinstance(document, Mapping):
        raise BadArgument("a domain is a JSON object with a kind")
    fields = dict(document)
    kind = fields.pop("kind", DOMAINS.default)
    made: Any = DOMAINS.documents.get(kind) if isinstance(kind, str) else None
    if made is None:
        raise BadArgument(f"unknown kind of domain {kind!r}; there are {', '.join(DOMAINS.documents)}")
    if made is domains.Blocks:
        return Blocks.of(fields)
    known = [name for name in keys_of(made) if name != "kind"]
    unknown = [name for name in fields if name not in known]
    if unknown:
        advice = made.REFUSED.get(unknown[0], f"it has {', '.join(known)}")
        raise BadArgument(f"a domain of kind {kind} has no {', '.join(map(str, unknown))}; {advice}")
    missing = [name for name in required_of(made) if name in known and name not in fields]
    if missing:
        raise BadArgument(f"a domain of kind {kind} needs {', '.join(missing)}")
    if made is MeshFile and not isinstance(fields["file"], str):
        raise BadArgument("a domain of kind mesh needs its file, a text")
    found: Domain = made(**{name: _value(name, types_of(made)[name], value) for name, value in fields.items()})
    return found


def _json_of(name: str, kind: Any, domain: DomainDocument) -> Any:
    """The JSON of a pair or a curve, which is checked; None for other fields."""
    if kind == Pair:
        return _pair(name, getattr(domain, name))
    return _curve(name, getattr(domain, name)) if one_of(kind) is CURVES else None


def _value(name: str, kind: Any, value: object) -> Any:
    """The value of a field of a domain from its JSON."""
    if kind == Pair:
        return tuple(_pair(name, value))
    if one_of(kind) is CURVES:
        return _read_curve(name, value)
    words = (False, True) if kind is bool else _words(kind)
    if words and not any(value is word or (isinstance(word, str) and value == word) for word in words):
        raise BadArgument(f"{name} of a domain is one of {', '.join(map(repr, words))}; not {value!r:.80}")
    return value


def _words(kind: Any) -> tuple[Any, ...]:
    """The words of a type that is one of them, or None; empty for other types."""
    words = [word for part in get_args(kind) if get_origin(part) is Literal for word in get_args(part)]
    return (None, *words) if words else ()


def _pair(name: str, value: object) -> list[float]:
    entries = value.tolist() if isinstance(value, np.ndarray) else value
    try:
        first, second = entries  # type: ignore[misc]
        return [float(first), float(second)]
    except (TypeError, ValueError):
        raise BadArgument(f"{name} of a domain is a pair of numbers, such as (0, 1); not {value!r:.80}") from None


def _curve(name: str, value: object) -> Json:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple | list) and len(value) in (2, 3) and all(isinstance(text, str) for text in value[:2]):
        curve: Json = {"x": value[0], "y": value[1]}
        if len(value) == 3 and value[2]:
            curve["parameters"] = {key: float(number) for key, number in dict(value[2]).items()}
        return curve
    try:
        points = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise BadArgument(
            f"{name} is a pair of formulas in t, such as ('t', '0'), or finite points of shape (n, 2);"
            f" not {value!r:.80}"
        )
    return {"points": points.tolist()}


def _read_curve(name: str, value: object) -> object:
    if isinstance(value, Mapping):
        if set(value) == {"points"}:
            return value["points"]
        if {"x", "y"} <= set(value) <= {"x", "y", "parameters"}:
            return (value["x"], value["y"], value.get("parameters") or {})
    raise BadArgument(f'{name} must be {{"x": "...", "y": "...", "parameters": {{}}}} or {{"points": [[x, y], ...]}}')


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
