"""Physical domains, as dataclasses and as the JSON of the HTTP interface."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from equimesh_client.errors import BadArgument
from equimesh_client.spec.blocks import Blocks, MeshFile

Json: TypeAlias = dict[str, Any]
Pair: TypeAlias = tuple[float, float]
Box: TypeAlias = tuple[Pair, Pair]
UNIT_BOX: Box = ((0.0, 1.0), (0.0, 1.0))
QUARTER_TURN: Pair = (0.0, 90.0)
"""The angles of a sector that gives none."""
ONE_TURN: Pair = (0.0, 360.0)
"""The angles of a closed ring that gives none."""
FOUR_SIDES = ("bottom", "right", "top", "left")
"""The curves of a quadrilateral."""
WORDS = {"periodic": (None, "x", "y", "both"), "closed": (False, True)}
"""Fields of a domain that are no pairs of numbers, with their values."""


@dataclass(frozen=True, kw_only=True)
class Rectangle:
    """The rectangle between ``x = (x0, x1)`` and ``y = (y0, y1)``; the unit square unless given.

    ``periodic`` names the directions in which it repeats itself, ``"x"``, ``"y"`` or ``"both"``: its sides there are
    one seam, across which grid lines go on.
    """

    x: Pair = (0.0, 1.0)
    y: Pair = (0.0, 1.0)
    periodic: Literal["x", "y", "both"] | None = None

    def json(self) -> Json:
        """The JSON of the domain."""
        return {"kind": "rectangle", "x": _pair("x", self.x), "y": _pair("y", self.y), "periodic": self.periodic}

    @property
    def box(self) -> Box | None:
        """The smallest box around the domain, which is the domain itself."""
        (x0, x1), (y0, y1) = _pair("x", self.x), _pair("y", self.y)
        return (x0, x1), (y0, y1)


@dataclass(frozen=True, kw_only=True)
class AnnulusSector:
    """The points whose distance from ``center`` lies between ``radii``, in directions between ``angles`` (degrees).

    The left side is the inner arc, the right one the outer; bottom is the first angle, top the last. ``closed`` makes
    the lines around a full ring closed: bottom and top are then one seam. The angles are 0 to 360 then, unless given.
    """

    center: Pair = (0.0, 0.0)
    radii: Pair = (1.0, 2.0)
    angles: Pair = QUARTER_TURN
    closed: bool = False

    def __post_init__(self) -> None:
        if self.closed is True and self.angles is QUARTER_TURN:
            object.__setattr__(self, "angles", ONE_TURN)

    def json(self) -> Json:
        """The JSON of the domain."""
        pairs = {name: _pair(name, getattr(self, name)) for name in ("center", "radii", "angles")}
        return {"kind": "annulus_sector", **pairs, "closed": self.closed}

    @property
    def box(self) -> Box | None:
        """The smallest box around the domain: corners, and the outer arc where it crosses a direction of the axes."""
        (first, last), radii, center = _pair("angles", self.angles), _pair("radii", self.radii), self.center
        quarters = range(math.ceil(first / 90.0), math.floor(last / 90.0) + 1)
        ends = [(r, _direction(angle)) for r in radii for angle in (first, last)]
        ends += [(radii[1], _direction(90.0 * quarter)) for quarter in quarters]
        box = [(c + min(r * d[k] for r, d in ends), c + max(r * d[k] for r, d in ends)) for k, c in enumerate(center)]
        return box[0], box[1]


@dataclass(frozen=True, kw_only=True)
class Quadrilateral:
    """The domain between four curves. ``bottom`` and ``top`` run from left to right, ``left`` and ``right`` upwards.

    A curve is a pair of formulas in t, which runs from 0 to 1, such as ``("cos(pi*t/2)", "sin(pi*t/2)")``, with the
    values of further names as a third item if it has any, ``("r*t", "0", {"r": 2.0})``; or points of shape ``(n, 2)``
    for a cubic spline through them: two points are a straight line. ``closed`` makes an O-grid: two opposite sides are
    then one curve, the seam, across which grid lines go on.
    """

    bottom: object
    right: object
    top: object
    left: object
    closed: bool = False

    def json(self) -> Json:
        """The JSON of the domain. Raises :class:`BadArgument` for a side that is no curve."""
        sides = {name: _curve(name, getattr(self, name)) for name in FOUR_SIDES}
        return {"kind": "quadrilateral", **sides, "closed": self.closed}

    @property
    def box(self) -> Box | None:
        """None: only the service evaluates the curves."""
        return None


Domain: TypeAlias = Rectangle | AnnulusSector | Quadrilateral | Blocks | MeshFile
MESHES = ("blocks", "mesh")
"""The kinds of domains that have points of their own."""
KINDS: Mapping[str, type[Domain]] = {
    "rectangle": Rectangle,
    "annulus_sector": AnnulusSector,
    "quadrilateral": Quadrilateral,
    "blocks": Blocks,
    "mesh": MeshFile,
}


def domain_json(domain: Domain | Mapping[str, Any]) -> Json:
    """The JSON of a domain; a mapping is such JSON already."""
    if isinstance(domain, Mapping):
        return dict(domain)
    if isinstance(domain, tuple(KINDS.values())):
        return domain.json()
    kinds = "a Rectangle, AnnulusSector, Quadrilateral, Blocks or MeshFile"
    raise BadArgument(f"a domain is {kinds}, or its JSON; not {domain!r:.80}")


def has_own_points(domain: Domain | Mapping[str, Any] | None) -> bool:
    """Whether the points of a mesh are those of its domain, as of blocks, which no grid is given for."""
    return domain is not None and domain_json(domain).get("kind") in MESHES


def read_domain(document: object) -> Domain:
    """The domain of a JSON document of the HTTP interface; raises :class:`BadArgument` for another document."""
    if not isinstance(document, Mapping):
        raise BadArgument("a domain is a JSON object with a kind")
    fields = dict(document)
    kind = fields.pop("kind", "rectangle")
    domain_class: Any = KINDS.get(kind) if isinstance(kind, str) else None
    if domain_class is None:
        raise BadArgument(f"unknown kind of domain {kind!r}; there are {', '.join(KINDS)}")
    if domain_class is Blocks:
        return Blocks.of(fields)
    known = tuple(domain_class.__dataclass_fields__)
    unknown = [name for name in fields if name not in known]
    if unknown:
        raise BadArgument(f"a domain of kind {kind} has no {', '.join(map(str, unknown))}; it has {', '.join(known)}")
    if domain_class is MeshFile:
        if not isinstance(fields.get("file"), str):
            raise BadArgument("a domain of kind mesh needs its file, a text")
        return MeshFile(**fields)
    if domain_class is not Quadrilateral:
        found: Domain = domain_class(**{name: _value(name, value) for name, value in fields.items()})
        return found
    missing = [name for name in FOUR_SIDES if name not in fields]
    if missing:
        raise BadArgument(f"a quadrilateral needs its four curves; missing: {', '.join(missing)}")
    closed = _value("closed", fields.pop("closed", False))
    return Quadrilateral(**{name: _read_curve(name, value) for name, value in fields.items()}, closed=closed)


def _value(name: str, value: object) -> Any:
    if name not in WORDS:
        return _as_tuple(name, value)
    if not any(value is word or (isinstance(word, str) and value == word) for word in WORDS[name]):
        raise BadArgument(f"{name} of a domain is one of {', '.join(map(repr, WORDS[name]))}; not {value!r:.80}")
    return value


def _as_tuple(name: str, value: object) -> Pair:
    first, second = _pair(name, value)
    return first, second


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


def _direction(degrees: float) -> Sequence[float]:
    """Cosine and sine, exact at multiples of a right angle."""
    quarter, rest = divmod(degrees, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    return math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
