"""u by values at the nodes of a mesh, as a function of x and y."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.errors import SamplesError
from equimesh.fields.bicubic import Bicubic
from equimesh.fields.mesh_map import MeshMap, Places, through
from equimesh.fields.patches import slopes_on_mesh
from equimesh.formulas.vocabulary import LIMITS
from equimesh.inputs import real_array
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array


@dataclass(frozen=True, kw_only=True, eq=False, repr=False, init=False)
class NodalField:
    """u from ``values`` of shape ``(n_xi, n_eta)`` at the nodes of ``mesh``.

    u and the map of the mesh are bicubic splines over its grid, so that linear functions are exact on every mesh; for a
    smooth map and smooth u the values are accurate to O(h^4), the gradient to O(h^3), second derivatives to O(h^2).
    Where the spline of a strongly graded mesh cannot be inverted, u is bilinear in the cell; outside the mesh the
    nearest point of its side is used.

    Implements :class:`~equimesh.fields.field.Field`. Raises :class:`~equimesh.errors.SamplesError`, which names the
    first bad index, and :class:`~equimesh.errors.InputError` for a folded mesh.
    """

    mesh: Mesh
    values: Array
    _map: MeshMap
    _spline: Bicubic

    def __init__(self, *, mesh: Mesh, values: npt.ArrayLike) -> None:
        checked = nodal_values(values, mesh, "values")
        for name, value in {
            "mesh": mesh, "values": checked, "_map": MeshMap.of(mesh), "_spline": through(checked),
        }.items():  # fmt: skip
            object.__setattr__(self, name, value)

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """u and its partial derivatives up to ``order``, each of the points' shape: see ``Field.evaluate``."""
        x, y = np.broadcast_arrays(x, y)
        places = self._map.locate(x, y)
        parts = list(self._derivatives(places, order))
        if not places.smooth.all():
            rough = np.flatnonzero(~places.smooth)
            for part, bilinear in zip(parts, in_cells(self._map.mesh, self.values, places, rough), strict=False):
                part[rough] = bilinear
        nowhere = np.isnan(x) | np.isnan(y)
        if not nowhere.any():
            return tuple(part.reshape(x.shape) for part in parts)
        return tuple(np.where(nowhere, np.nan, part.reshape(x.shape)) for part in parts)

    def __repr__(self) -> str:
        return f"NodalField({self.mesh.grid})"

    def _derivatives(self, places: Places, order: int) -> tuple[Array, ...]:
        """By the chain rule from those over the grid."""
        patches = self._spline.polynomials, self._map.x.polynomials, self._map.y.polynomials
        if order == 1 and patches[0] is not None and patches[1] is not None and patches[2] is not None:
            rows, axes = np.empty((3, places.s.size)), (self._spline.along_x, self._spline.along_y)
            slopes_on_mesh(places.s, places.t, *axes, patches[0], (patches[1], patches[2]), rows)
            return tuple(rows)
        u, *of_u = self._spline.evaluate(places.s, places.t, order)
        if order == 0:
            return (u,)
        (_, *of_x), (_, *of_y) = (part.evaluate(places.s, places.t, order) for part in (self._map.x, self._map.y))
        (x_s, x_t), (y_s, y_t) = of_x[:2], of_y[:2]
        with np.errstate(all="ignore"):  # where it is not smooth, these values are replaced
            per_det = 1.0 / (x_s * y_t - x_t * y_s)
            s_x, s_y, t_x, t_y = y_t * per_det, -x_t * per_det, -y_s * per_det, x_s * per_det
            u_x, u_y = of_u[0] * s_x + of_u[1] * t_x, of_u[0] * s_y + of_u[1] * t_y
            if order == 1:
                return u, u_x, u_y
            ss, st, tt = (of_u[k] - u_x * of_x[k] - u_y * of_y[k] for k in (2, 3, 4))
            u_xx = s_x * (ss * s_x + st * t_x) + t_x * (st * s_x + tt * t_x)
            u_xy = s_x * (ss * s_y + st * t_y) + t_x * (st * s_y + tt * t_y)
            u_yy = s_y * (ss * s_y + st * t_y) + t_y * (st * s_y + tt * t_y)
        return u, u_x, u_y, u_xx, u_xy, u_yy


def nodal_values(values: npt.ArrayLike, mesh: Mesh, name: str) -> Array:
    """Finite numbers at all nodes; raises :class:`~equimesh.errors.SamplesError` with ``name`` as its field."""
    checked = real_array(values, name, ndim=2)
    if checked.shape != mesh.x.shape:
        hint = "; transpose it" if checked.shape == mesh.x.shape[::-1] else ""
        raise SamplesError(
            f"{name} has shape {checked.shape}, but the mesh has {mesh.x.shape} nodes: one value is needed at each,"
            f" xi first{hint}",
            field=name,
        )
    large = np.abs(checked) > LIMITS.magnitude
    if large.any():
        i, j = np.argwhere(large)[0]
        raise SamplesError(
            f"{name}[{i}][{j}] = {checked[i, j]:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale it",
            field=name,
        )
    return np.ascontiguousarray(checked)


def in_cells(mesh: Mesh, values: Array, places: Places, which: npt.NDArray[np.int64]) -> tuple[Array, ...]:
    """u, u_x, u_y of the bilinear cells, and second derivatives, which are set to zero."""
    i = np.minimum(places.s[which].astype(int), mesh.x.shape[0] - 2)
    j = np.minimum(places.t[which].astype(int), mesh.x.shape[1] - 2)
    a, b = places.s[which] - i, places.t[which] - j

    def at(nodal: Array) -> tuple[Array, Array, Array]:
        lower, upper = nodal[i, j] + b * (nodal[i, j + 1] - nodal[i, j]), nodal[i + 1, j]
        upper = upper + b * (nodal[i + 1, j + 1] - nodal[i + 1, j])
        across = nodal[i, j + 1] - nodal[i, j]
        return lower + a * (upper - lower), upper - lower, across + a * (nodal[i + 1, j + 1] - nodal[i + 1, j] - across)

    (u, u_s, u_t), (_, x_s, x_t), (_, y_s, y_t) = at(values), at(mesh.x), at(mesh.y)
    det, nothing = x_s * y_t - x_t * y_s, np.zeros(which.size)
    return u, (u_s * y_t - u_t * y_s) / det, (u_t * x_s - u_s * x_t) / det, nothing, nothing, nothing
