"""A laser that moves around over a plate. It regulates its power by the temperature below it.

pip install 'equimesh[solver]' 'pyprecice>=3.2' scikit-fem
python laser.py & python plate.py
"""

from pathlib import Path

import numpy as np
import precice

import equimesh as em
from equimesh_coupling import PreciceMesh

WANTED, RADIUS, PERIOD = 1.0, 0.06, 1.0


def main() -> list[float]:
    participant = precice.Participant("Laser", str(Path(__file__).with_name("precice-config.xml")), 0, 1)
    grid = em.Mesh.uniform(em.Grid(n_xi=41, n_eta=41))
    mesh = PreciceMesh(participant, "Laser-Mesh", grid)
    participant.initialize()
    time, power, below = 0.0, 20.0, []
    while participant.is_coupling_ongoing():
        dt = participant.get_max_time_step_size()
        time += dt
        angle = 2 * np.pi * time / PERIOD
        spot = (grid.x - 0.5 - 0.25 * np.cos(angle)) ** 2 + (grid.y - 0.5 - 0.25 * np.sin(angle)) ** 2
        mesh.write("Heat", power * np.exp(-spot / (2 * RADIUS**2)))
        participant.advance(dt)
        below.append(float(mesh.read("Temperature").flat[spot.argmin()]))
        power *= (WANTED / max(below[-1], 0.5)) ** 0.5
        print(f"laser: time {time:.2f}, temperature below it {below[-1]:.3f}, power {power:.1f}")
    participant.finalize()
    return below


if __name__ == "__main__":
    main()
