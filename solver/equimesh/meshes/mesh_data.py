"""A mesh with values computed on it: the contents of a mesh file."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshData:
    """A mesh with values at its nodes and cells.

    ``u`` at the nodes, shape ``(n_xi, n_eta)``, ``None`` where the monitor has no u; per cell, shape
    ``(n_xi - 1, n_eta - 1)``, the measure ``q_eq`` and the number of the ``subdomain`` that computed the cell.
    ``fields`` are further values at the nodes and ``cell_fields`` such values per cell, by names other than those that
    files have already; a vector has a third axis, that of its components. ``step`` is the JSON that a step of a
    sequence answers with, for npz files; it is empty for other meshes.

    Raises :class:`~equimesh.errors.InputError` for other shapes.
    """

    mesh: Mesh
    u: Array | None
    q_eq: Array
    subdomain: IntArray
    fields: Mapping[str, Array] = field(default_factory=dict)
    cell_fields: Mapping[str, Array] = field(default_factory=dict)
    step: str = ""

    def __post_init__(self) -> None:
        n_xi, n_eta = nodes = self.mesh.x.shape
        for name, shape in (
            ("u", nodes),
            ("q_eq", (n_xi - 1, n_eta - 1)),
            ("subdomain", (n_xi - 1, n_eta - 1)),
        ):
            values = getattr(self, name)
            found = shape if values is None and name == "u" else values.shape
            if found != shape:
                raise InputError(f"{name} has shape {found}, this mesh needs {shape}", field=name)
        for fields, needed in ((self.fields, nodes), (self.cell_fields, (n_xi - 1, n_eta - 1))):
            for name, values in fields.items():
                if values.shape[:2] != needed or values.ndim > 3:
                    raise InputError(f"the field {name} has shape {values.shape}, this mesh needs {needed}", field=name)

    @property
    def computational(self) -> tuple[Array, Array]:
        """``xi`` and ``eta`` of the nodes, each of shape ``(n_xi, n_eta)``."""
        uniform = Mesh.uniform(self.mesh.grid)
        return uniform.x, uniform.y

    def triangles(self) -> IntArray:
        """The cells cut into triangles, as :meth:`Mesh.triangles` does it."""
        return self.mesh.triangles()
