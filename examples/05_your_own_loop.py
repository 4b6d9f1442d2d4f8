"""Your own loop over the Schwarz iteration: your start, your progress, your deadline, your reason to stop.

`equimesh.iterate` yields one record per iteration, without end; your loop decides when to stop. Here a front grows, and
every mesh starts from the mesh of the time before.

    pip install 'equimesh[solver,plot]'
    python 05_your_own_loop.py
"""

import argparse
import time
from pathlib import Path

import equimesh as em
from equimesh.plot import draw_histories, draw_mesh

SECONDS = 30.0  # for one mesh
TOLERANCE = 1e-6
FRONT = "tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.06 - t))"
SCHWARZ = em.Schwarz(overlap=4, transmission=em.NonlinearRobin(p="auto"), ordering=em.Ordering.ALTERNATING)


def problem(t: float) -> em.Problem:
    """The mesh for the front at time t."""
    return em.Problem(monitor=em.ArcLength(u=em.Expression(FRONT, t=t)), grid=em.Grid(n_xi=33, n_eta=33))


def follow(t: float, start: em.Mesh) -> list[em.Iteration]:
    """The iterations at time t, up to the tolerance or the deadline."""
    deadline = time.monotonic() + SECONDS
    records: list[em.Iteration] = []
    for record in em.iterate(problem(t), SCHWARZ, start):
        records.append(record)
        if record.iteration:
            steps = "+".join(str(part.newton_steps) for part in record.subdomains)
            print(f"  iteration {record.iteration}: nodes moved by {record.change:.1e}, Newton steps {steps}")
        if record.meets(TOLERANCE):  # also requires that every subdomain is solved and no cell is folded
            return records
        if record.failed or time.monotonic() > deadline:
            raise SystemExit(f"t = {t}: no mesh after {record.iteration} iterations")
    return records


def main(output: Path) -> None:
    mesh = em.solve(problem(0.0)).mesh  # the first mesh needs no decomposition
    histories = {}
    for t in (0.01, 0.02, 0.03):
        print(f"t = {t}")
        records = follow(t, start=mesh)
        mesh = records[-1].mesh
        histories[f"t = {t}"] = [record.change for record in records[1:]]
        print(f"  max Q_eq {records[-1].max_q_eq:.4f}, smallest corner Jacobian {mesh.min_jacobian:.3f}")

    title = "A growing front, 2 strips, nonlinear Robin: each starts from the mesh before"
    draw_histories(histories, output / "loop.png", title=title, ylabel="largest move of a node", first=1)
    (u,) = problem(t).monitor.u.evaluate(mesh.x, mesh.y)
    parts = SCHWARZ.decompose(mesh.grid)
    q_eq = em.measure(mesh, problem(t).monitor).q_eq.cells
    data = em.MeshData(mesh=mesh, u=u, q_eq=q_eq, subdomain=parts.owner_of_cells())
    draw_mesh(data, output / "loop_mesh.png", decomposition=parts)
    print(f"wrote {output / 'loop.png'} and {output / 'loop_mesh.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
