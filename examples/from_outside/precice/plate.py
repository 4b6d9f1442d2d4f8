"""The heat equation on a mesh that follows the spot of a laser; preCICE gives the heat of each time window.

pip install 'equimesh[solver]' 'pyprecice>=3.2' scikit-fem
python laser.py & python plate.py
"""

from pathlib import Path

import numpy as np
import precice
import skfem
from skfem.models.poisson import laplace, mass

import equimesh as em
from equimesh_coupling import PreciceMesh

CONDUCTIVITY = 0.02


def warmed(mesh: em.Mesh, temperature, heat, dt):
    """The temperature after a step of the implicit Euler method; the sides lose no heat."""
    basis = skfem.Basis(mesh.to_skfem(cells="quad"), skfem.ElementQuad1())
    m, k = mass.assemble(basis), laplace.assemble(basis)
    right = m @ (temperature + dt * heat).ravel()
    return skfem.solve(m + dt * CONDUCTIVITY * k, right).reshape(temperature.shape), float((m @ heat.ravel()).sum())


def conserved(values):
    """A field whose integral is carried from mesh to mesh."""
    return em.MeshValues(values, transfer="conservative")


def main() -> tuple[float, float, list[em.Mesh]]:
    participant = precice.Participant("Plate", str(Path(__file__).with_name("precice-config.xml")), 0, 1)
    meshes = [em.Mesh.uniform(em.Grid(n_xi=25, n_eta=25))]
    sequence = em.Sequence(em.Problem(monitor=em.Curvature(u="x"), grid=meshes[0].grid), mesh=meshes[0])
    mesh = PreciceMesh(participant, "Plate-Mesh", meshes[0])
    participant.initialize()
    temperature = heat = np.zeros(meshes[0].node_shape)
    taken = 0.0
    while participant.is_coupling_ongoing():
        dt = participant.get_max_time_step_size()
        temperature, power = warmed(meshes[-1], temperature, heat, dt)
        taken += power * dt
        mesh.write("Temperature", temperature)
        participant.advance(dt)
        heat = mesh.read("Heat")  # before the mesh moves
        if participant.is_coupling_ongoing():
            step = sequence.step(temperature + heat / heat.max(), {"T": conserved(temperature), "q": conserved(heat)})
            mesh.move(step.mesh)
            meshes.append(step.mesh)
            temperature, heat = step.fields["T"], step.fields["q"]
    participant.finalize()
    stored = em.integral(meshes[-1], temperature, "nodes")
    print(f"plate: {len(meshes) - 1} moves, heat taken {taken:.6f}, heat stored {stored:.6f}")
    return taken, stored, meshes


if __name__ == "__main__":
    main()
