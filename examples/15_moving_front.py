"""A mesh that follows a front: an advection solver, and a sequence of meshes at a service that moves with it.

u_t + u_x = 0 with a wavy front, by semi-Lagrangian steps: u at a node is the u at the point that moves there. The
same scheme on a fixed uniform mesh with the same number of nodes is the comparison.

    pip install 'equimesh[service]' && python 15_moving_front.py
"""

import argparse
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

import equimesh as em
from equimesh_client import Client, Curvature

N, STEPS, DT = 41, 10, 0.02
FRONT = "tanh(30*(x - 0.4 - t - 0.05*sin(2*pi*y)))"
SMOOTH = Curvature(u=FRONT, smoothing=0.02)  # values are taken from mesh to mesh by splines, which want smooth lines


def front(x, y, t):
    """The exact solution."""
    return em.Expression(FRONT, t=t).evaluate(x, y)[0]


def advected(x, y, u):
    """u at the nodes one time step later."""
    return em.NodalField(mesh=em.Mesh(x, y), values=u).evaluate(x - DT, y)[0]


def error(x, y, u, t):
    """The L2 norm of the bilinear interpolant of u minus the exact solution, by 4 x 4 points in each cell."""
    total, (a, b) = 0.0, np.meshgrid(*[(np.arange(4) + 0.5) / 4] * 2)
    areas = em.Mesh(x, y).corner_jacobians().mean(axis=0) / (x.shape[0] - 1) / (x.shape[1] - 1)
    for s, r in zip(a.ravel(), b.ravel(), strict=True):
        weights = ((1 - s) * (1 - r), s * (1 - r), s * r, (1 - s) * r)
        corners = [(z[:-1, :-1], z[1:, :-1], z[1:, 1:], z[:-1, 1:]) for z in (x, y, u)]
        at = [sum(w * z for w, z in zip(weights, four, strict=True)) for four in corners]
        total += np.sum(areas * (at[2] - front(at[0], at[1], t)) ** 2) / 16
    return float(np.sqrt(total))


def main(url: str | None, output: Path) -> None:
    with ExitStack() as stack:
        if url is None:
            from equimesh_service import Settings, running

            folder = stack.enter_context(TemporaryDirectory())
            url = stack.enter_context(running(Settings(port=0, workers=1, data_dir=folder, log_level="warning")))
        sequence = stack.enter_context(Client(url)).sequences.start(n=N, monitor=SMOOTH)
        x, y = np.meshgrid(*[np.linspace(0, 1, N)] * 2, indexing="ij")
        u = front(x, y, 0.0)
        moving, shown = sequence.current, [sequence.current]
        print("time   L2 error: moving mesh   uniform mesh")
        for t in DT * np.arange(1, STEPS + 1):
            moving = sequence.step(advected(moving.x, moving.y, moving.u))
            u = advected(x, y, u)
            print(f"{t:.2f}   {error(moving.x, moving.y, moving.u, t):>21.2e}   {error(x, y, u, t):>12.2e}")
            shown += [moving] if moving.number % 5 == 0 else []
        sequence.delete()
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    for step, axes in zip(shown, figure.subplots(1, 3), strict=True):
        axes.pcolormesh(step.x, step.y, step.u, shading="gouraud", cmap="coolwarm", vmin=-1, vmax=1)
        axes.plot(step.x, step.y, step.x.T, step.y.T, color="black", linewidth=0.3)
        axes.set(title=f"t = {step.number * DT:.1f}", aspect="equal")
    figure.savefig(output / "moving-front.png", dpi=120)
    print(f"wrote {output / 'moving-front.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", help="address of a service; without it one is started")
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.url, options.output)
