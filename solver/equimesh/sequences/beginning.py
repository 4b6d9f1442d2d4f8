"""What a sequence begins with: its settings, and its first mesh."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np

from equimesh.domains.domain import Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.mesh_map import reference_of
from equimesh.inputs import describe_value
from equimesh.meshes.mesh import Mesh
from equimesh.solving.solution import Solution
from equimesh.transfers.one_domain import MAX_ROUNDING, require_one_domain, require_valid

OUTRUN = ("substeps", "refuse")
# The largest share of the mesh before in a mesh that is smoothed in time.
MAX_SMOOTHING = 0.9


def check_settings(smoothing: Any, max_move: Any, outrun: Any) -> None:
    """Raise :class:`~equimesh.errors.InputError` for settings that a sequence cannot have."""
    if not (_is_number(smoothing) and 0.0 <= smoothing <= MAX_SMOOTHING):
        raise InputError(f"smoothing = {smoothing!r}: the share lies between 0 and {MAX_SMOOTHING}", field="smoothing")
    if not (_is_number(max_move) and max_move > 0.0):
        raise InputError(f"max_move = {max_move!r}: a positive number of cells; 1 is usual", field="max_move")
    if outrun not in OUTRUN:
        raise InputError(f"outrun = {outrun!r}: choose 'substeps' or 'refuse'", field="outrun")


def first_mesh(begin: Solution | Mesh | None, domain: Domain) -> tuple[Mesh, Mesh]:
    """The mesh of the domain that a sequence begins with, and the same mesh on the reference square.

    Raises :class:`~equimesh.errors.InputError` for what is no mesh and no solution, for a folded mesh, and for one of
    another domain.
    """
    if isinstance(begin, Solution):
        mesh, reference = begin.mesh, begin.reference
    elif isinstance(begin, Mesh):
        require_valid(begin)
        mesh, reference = begin, reference_of(begin, domain)
    else:
        raise InputError(
            f"a sequence cannot begin with {describe_value(begin)}: give mesh= an em.Mesh, or solution= the result of"
            " em.solve",
            field="mesh",
        )
    if not _is_of(domain, mesh, reference):
        raise InputError("the first mesh of a sequence must be one of the problem's domain", field="mesh")
    return mesh, reference


def _is_of(domain: Domain, mesh: Mesh, reference: Mesh) -> bool:
    """Whether a mesh is the image of its reference; where that was not found exactly, its sides decide."""
    extent = max(np.ptp(mesh.x), np.ptp(mesh.y))
    if mesh.distance(map_mesh(reference, domain)) <= MAX_ROUNDING * extent:
        return True
    try:
        require_one_domain(mesh, map_mesh(Mesh.uniform(mesh.grid), domain))
    except InputError:
        return False
    return True


def _is_number(value: object) -> bool:
    return isinstance(value, Real)
