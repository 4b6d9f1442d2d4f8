"""Physical domains and grids of a document."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.counts import plan_of
from equimesh.blocks.description import Description
from equimesh.domains.curve import Curve
from equimesh.domains.domain import AnnulusSector, Domain, Rectangle
from equimesh.domains.quadrilateral import Quadrilateral
from equimesh.errors import InputError
from equimesh.specs.document import Makers, Reading, several, text
from equimesh_schema import domains as schema

FindMesh: TypeAlias = Callable[[str, Mapping[str, Any]], Blocks]
"""The blocks of the mesh file with a name, by the ``corners`` and the ``corner_angle`` of a document."""


def build_domain(document: object, find_mesh: FindMesh | None = None, path: str = "domain") -> Domain | Blocks:
    """The domain that ``document`` describes, a rectangle where it has no ``kind``.

    ``find_mesh(name, settings)`` returns the blocks of the mesh file of a domain of kind ``mesh``.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``path``.
    """
    found: Domain | Blocks = Reading(domain_makers(find_mesh or no_meshes)).one_of(schema.DOMAINS, document, path)
    return found


def count_points(document: Mapping[str, Any]) -> int:
    """The number of nodes of the mesh that a description of blocks gives, which is not made.

    Raises :class:`~equimesh.errors.InputError`, whose field begins with ``domain``.
    """
    return plan_of(Description.of(document)).layout.node_count


def domain_makers(find_mesh: FindMesh, folder: Path | None = None) -> Makers:
    """What makes domains and their curves: ``find_mesh`` finds mesh files, files of points lie in ``folder``."""

    def blocks(**given: Any) -> Blocks:
        return Blocks.of({name: value for name, value in given.items() if value is not None}, folder)

    def mesh(file: object, corners: object = (), corner_angle: float | None = None) -> Blocks:
        kept = several(lambda corner, _: corner, corners, "corners")
        settings = {"corners": kept or None, "corner_angle": corner_angle}
        return find_mesh(text(file, "file"), {name: value for name, value in settings.items() if value is not None})

    return {
        schema.Rectangle: Rectangle,
        schema.AnnulusSector: AnnulusSector,
        schema.Quadrilateral: Quadrilateral,
        schema.FormulaCurve: Curve.of_expressions,
        schema.PointCurve: Curve.through,
        schema.Blocks: blocks,
        schema.MeshFile: mesh,
    }


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
