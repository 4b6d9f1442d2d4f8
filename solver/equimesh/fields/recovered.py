"""u as a function of x and y from the values of a solver at the nodes of a mesh of a domain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy.typing as npt

from equimesh.domains.domain import Domain, Rectangle
from equimesh.fields.field import Field
from equimesh.fields.hermite_field import HermiteField
from equimesh.fields.mesh_map import reference_of
from equimesh.fields.on_domain import OnDomain
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovered:
    """The function ``u`` and its nodes: ``reference``, their mesh of the unit square, and the ``values`` there."""

    u: Field
    reference: Mesh
    values: Array


def recover(mesh: Mesh, values: npt.ArrayLike, domain: Domain) -> Recovered:
    """u from ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``, a mesh of ``domain``.

    Raises as :class:`~equimesh.fields.hermite_field.HermiteField`. On a domain with curved sides u is recovered on the
    reference square, so that a layer along such a side has the values of that side on all of it.
    """
    is_straight = isinstance(domain, Rectangle)
    reference = reference_on(mesh, domain)
    own = HermiteField(mesh=mesh if is_straight else reference, values=values)
    u = own if is_straight else OnDomain(reference=own, domain=domain)
    return Recovered(u=u, reference=reference, values=own.values)


def reference_on(mesh: Mesh, domain: Domain) -> Mesh:
    """The mesh of the reference square whose image is ``mesh``; its sides are those of the square exactly."""
    if not isinstance(domain, Rectangle):
        return reference_of(mesh, domain)
    if domain.is_unit_square:
        return Mesh.of_unit_square(mesh.x, mesh.y)
    ((x0, x1), (y0, y1)) = domain.x, domain.y
    return Mesh.of_unit_square((mesh.x - x0) / (x1 - x0), (mesh.y - y0) / (y1 - y0))
