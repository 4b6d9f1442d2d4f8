"""A front that moves and diffuses, by dolfinx on the meshes of a sequence of a service; run by the Python of dolfinx
with the address of the service and a folder of packages.

u_t + u_x - EPS (u_xx + u_yy) = f, with u = tanh(STEEP (x + y/2 - 0.5 - t)) on the whole boundary. Each step solves on
the mesh before, lets the service move the mesh to what was found, and solves again on the new mesh, in one of two ways:

- "velocity": values stay at their nodes, which move with the velocity w of the mesh: convection is by (1, 0) - w.
- "transfer": the values of the step before are carried to the new nodes by the service.

Prints one line of JSON: the L2 error at the end for each way, and on a uniform mesh that does not move.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh
from dolfinx.fem.petsc import LinearProblem
from mpi4py import MPI

sys.path.append(sys.argv[2])  # the folder of the packages that the client needs

from equimesh_client import Client, Curvature
from equimesh_coupling.adaptors.dolfinx import mesh_of, nodal_values
from equimesh_coupling.parts import MeshParts

N, STEPS, DT = 25, 10, 0.02
STEEP, EPS = 30.0, 2e-3
DIRECT = {"ksp_type": "preonly", "pc_type": "lu"}


def exact(x: Any, y: Any, t: float) -> Any:
    """The solution."""
    return np.tanh(STEEP * (x + y / 2 - 0.5 - t))


class OnMesh:
    """The equation on a mesh: ``parts`` in the order of our nodes, and functions of dolfinx."""

    def __init__(self, parts: MeshParts) -> None:
        self.parts = parts
        domain, _ = mesh_of(parts, MPI.COMM_WORLD)
        self.space = fem.FunctionSpace(domain, ("Lagrange", 1))
        self.domain = domain
        number = fem.Function(self.space)
        number.x.array[:] = np.arange(len(number.x.array))
        self.dofs = nodal_values(number, parts).astype(int).ravel()

    def function(self, values: Any) -> Any:
        """The function of dolfinx with these values at our nodes."""
        found = fem.Function(self.space)
        found.x.array[self.dofs] = values.ravel()
        return found

    def solve(self, before: Any, t: float, velocity: Any = None) -> Any:
        """The values at the nodes at the time t, by an implicit step from those ``before`` at the same nodes."""
        domain, space = self.domain, self.space
        x, u, v = ufl.SpatialCoordinate(domain), ufl.TrialFunction(space), ufl.TestFunction(space)
        time = fem.Constant(domain, float(t))
        s = STEEP * (x[0] + x[1] / 2 - 0.5 - time)
        # f is what diffusion alone does to u: the rest of the equation is zero for it.
        f = EPS * 2 * STEEP**2 * 1.25 * ufl.tanh(s) * (1 - ufl.tanh(s) ** 2)
        zero = np.zeros((*self.parts.shape, 2))
        w = [self.function((zero if velocity is None else velocity)[..., k]) for k in range(2)]
        old, step = self.function(before), fem.Constant(domain, DT)
        convection = (1.0 - w[0]) * u.dx(0) - w[1] * u.dx(1)
        a = (u * v + step * (convection * v + EPS * ufl.inner(ufl.grad(u), ufl.grad(v)))) * ufl.dx
        right = (old + step * f) * v * ufl.dx
        points = self.parts.points
        fixed = self.function(exact(points[:, 0], points[:, 1], t))
        facets = dolfinx_mesh.locate_entities_boundary(domain, 1, lambda z: np.full(z.shape[1], True))
        rim = fem.dirichletbc(fixed, fem.locate_dofs_topological(space, 1, facets))
        found = LinearProblem(a, right, bcs=[rim], petsc_options=DIRECT).solve()
        return nodal_values(found, self.parts)

    def error(self, values: Any, t: float) -> float:
        """The L2 norm of the error."""
        x = ufl.SpatialCoordinate(self.domain)
        time = fem.Constant(self.domain, float(t))
        wrong = self.function(values) - ufl.tanh(STEEP * (x[0] + x[1] / 2 - 0.5 - time))
        square = fem.assemble_scalar(fem.form(wrong**2 * ufl.dx(metadata={"quadrature_degree": 8})))
        return float(np.sqrt(square))


def moving(client: Client, way: str) -> tuple[float, float]:
    """The L2 error at the end on the meshes of a sequence, and the largest velocity of a node."""
    monitor = Curvature(u=f"tanh({STEEP}*(x + y/2 - 0.5))", smoothing=0.1)
    sequence = client.sequences.start(n=N, monitor=monitor)
    here = OnMesh(sequence.current.arrays.mesh_parts())
    u, largest = exact(sequence.x, sequence.y, 0.0), 0.0
    for number in range(1, STEPS + 1):
        t = number * DT
        step = sequence.step(here.solve(u, t), fields={"before": u})
        assert step.status == "succeeded", step.warnings
        here = OnMesh(step.arrays.mesh_parts())
        if way == "velocity":
            u = here.solve(u, t, step.velocity / DT)
            largest = max(largest, float(np.abs(step.velocity).max()) / DT)
        else:
            u = here.solve(step.fields["before"], t)
    sequence.delete()
    return here.error(u, STEPS * DT), largest


def resting() -> float:
    """The L2 error at the end on the uniform mesh."""
    x, y = (z.ravel() for z in np.meshgrid(*[np.linspace(0, 1, N)] * 2, indexing="ij"))
    first = (N * np.arange(N - 1)[:, None] + np.arange(N - 1)).ravel()
    cells = first[:, None] + np.array([0, N, N + 1, 1])
    nodes = np.arange(N * N).reshape(N, N)
    lines = {"left": nodes[0, ::-1], "right": nodes[-1], "bottom": nodes[:, 0], "top": nodes[::-1, -1]}
    sides = {name: np.column_stack([line[:-1], line[1:]]) for name, line in lines.items()}
    here = OnMesh(MeshParts(points=np.column_stack([x, y]), cells=cells, sides=sides, shape=(N, N)))
    u = exact(x, y, 0.0).reshape(N, N)
    for number in range(1, STEPS + 1):
        u = here.solve(u, number * DT)
    return here.error(u, STEPS * DT)


def main(url: str) -> None:
    with Client(url) as client:
        velocity, largest = moving(client, "velocity")
        transfer, _ = moving(client, "transfer")
    print(json.dumps({"velocity": velocity, "transfer": transfer, "uniform": resting(), "largest velocity": largest}))


if __name__ == "__main__":
    main(sys.argv[1])
