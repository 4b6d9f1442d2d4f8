"""Physical domains and grids of a document."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeAlias

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description
from equimesh.domains.curve import Curve
from equimesh.domains.domain import AnnulusSector, Domain, Rectangle
from equimesh.domains.quadrilateral import Quadrilateral
from equimesh.errors import InputError
from equimesh.meshes.grid import Grid
from equimesh.specs.document import (
    ByKey,
    ByKind,
    Record,
    as_given,
    mapping,
    number,
    optional,
    several,
    text,
    whole,
    within,
)

USUAL_POINTS = 64  # a direction
FindMesh: TypeAlias = Callable[[str, Mapping[str, Any]], Blocks]
"""The blocks of the mesh file with a name, by the ``corners`` and the ``corner_angle`` of a document."""


def _grid(n_xi: int = USUAL_POINTS, n_eta: int = USUAL_POINTS) -> Grid:
    return Grid(n_xi=n_xi, n_eta=n_eta)


GRID = Record(_grid, {"n_xi": whole, "n_eta": whole})
CURVE = ByKey(
    {
        "x": Record(Curve.of_expressions, {"x": as_given, "y": as_given, "parameters": mapping}),
        "points": Record(Curve.through, {"points": as_given}),
    }
)
FOUR_SIDED: Mapping[str, Record[Domain]] = {
    "rectangle": Record(Rectangle, dict.fromkeys(("x", "y", "periodic"), as_given)),
    "annulus_sector": Record(AnnulusSector, dict.fromkeys(("center", "radii", "angles", "closed"), as_given)),
    "quadrilateral": Record(
        Quadrilateral, {**dict.fromkeys(("bottom", "right", "top", "left"), CURVE), "closed": as_given}
    ),
}


def build_domain(document: object, find_mesh: FindMesh | None = None, path: str = "domain") -> Domain | Blocks:
    """The domain that ``document`` describes, a rectangle where it has no ``kind``.

    ``find_mesh(name, settings)`` returns the blocks of the mesh file of a domain of kind ``mesh``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    found: Domain | Blocks = domain_reader(find_mesh or no_meshes)(document, path)
    return found


@dataclass(frozen=True, kw_only=True)
class _Description:
    """The keys of a description of blocks; those without a default are required."""

    vertices: object
    blocks: object
    curves: object = None
    edges: object = None
    joins: object = None
    sides: object = None
    corners: object = None
    refine: object = None

    @property
    def given(self) -> dict[str, object]:
        """What was given, as :meth:`equimesh.Blocks.of` takes it."""
        return {name: value for name, value in vars(self).items() if value is not None}


_DESCRIPTION = Record(_Description, dict.fromkeys((one.name for one in fields(_Description)), as_given))


def count_points(document: Mapping[str, Any]) -> int:
    """The number of nodes of the mesh that a description of blocks gives, which is not made.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``domain``.
    """
    return plan_of(Description.of(document)).layout.node_count


def domain_reader(find_mesh: FindMesh, folder: Path | None = None) -> ByKind[Domain | Blocks]:
    """The reader of domains, whose mesh files ``find_mesh`` finds; files of points lie in ``folder``."""

    def blocks(value: object, path: str) -> Blocks:
        description = _DESCRIPTION(value, path)
        with within(path):
            return Blocks.of(description.given, folder)

    def mesh(file: str, corners: tuple[Any, ...] = (), corner_angle: float | None = None) -> Blocks:
        settings = {"corners": corners or None, "corner_angle": corner_angle}
        return find_mesh(file, {name: value for name, value in settings.items() if value is not None})

    own: dict[str, Callable[[object, str], Blocks]] = {
        "blocks": blocks,
        "mesh": Record(mesh, {"file": text, "corners": several(as_given), "corner_angle": optional(number)}),
    }
    return ByKind({**FOUR_SIDED, **own}, default="rectangle")


def meshes_in(folder: Path) -> FindMesh:
    """Mesh files whose names are those of files in ``folder``, as :meth:`~equimesh.Blocks.read` reads them.

    What it returns raises :class:`~equimesh.errors.InputError` for a file that cannot be read.
    """

    def find(name: str, settings: Mapping[str, Any]) -> Blocks:
        try:
            return Blocks.read(folder / name, **settings)
        except OSError as error:
            raise InputError(f"{folder / name}: {error.strerror or error}", field="file") from error

    return find


def no_meshes(name: str, settings: Mapping[str, Any]) -> Blocks:  # noqa: ARG001 - a FindMesh
    """Raises :class:`~equimesh.errors.InputError`: there are no files with names."""
    raise InputError(f"there is no mesh file named {name[:40]!r} here: give find_mesh", field="file")
