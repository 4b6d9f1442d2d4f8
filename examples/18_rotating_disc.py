"""A disc that rotates, by finite volumes, on meshes that follow it in one process.

Averages over cells are carried from mesh to mesh with their integrals and within their bounds. The same scheme on the
uniform mesh with as many cells is the comparison.

    pip install 'equimesh[solver,plot]' && python 18_rotating_disc.py
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import equimesh as em

STEPS = 50
STEP = 2 * np.pi / STEPS  # the angle of a step: once around in all


def disc(angle):
    """1 inside of a disc, 0 outside."""
    return lambda x, y: 1.0 * (np.hypot(x - 0.5 - 0.22 * np.cos(angle), y - 0.5 - 0.22 * np.sin(angle)) < 0.15)


def areas(mesh):
    """The areas of the cells."""
    return mesh.corner_jacobians().mean(axis=0) / (mesh.x.shape[0] - 1) / (mesh.x.shape[1] - 1)


def averages(mesh, function, points=16):
    """Averages of a function over the cells, by samples."""
    corners = [np.stack([z[:-1, :-1], z[1:, :-1], z[1:, 1:], z[:-1, 1:]]) for z in (mesh.x, mesh.y)]
    whole = weight = 0.0
    for a in (np.arange(points) + 0.5) / points:
        for b in (np.arange(points) + 0.5) / points:
            shares = np.array([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])
            x, y, jacobian = (np.tensordot(shares, z, 1) for z in (*corners, mesh.corner_jacobians()))
            whole, weight = whole + jacobian * function(x, y), weight + jacobian
    return whole / weight


def at_nodes(q):
    """Values at the nodes: means of the cells around."""
    q = np.pad(q, 1, mode="edge")
    return 0.25 * (q[1:, 1:] + q[:-1, 1:] + q[1:, :-1] + q[:-1, :-1])


def slopes(q, axis):
    """Differences of averages along one family of lines, limited by Roe's superbee, for steep fronts."""
    d = np.diff(q, axis=axis)
    a, b = np.delete(d, -1, axis), np.delete(d, 0, axis)
    size = np.maximum(np.minimum(2 * abs(a), abs(b)), np.minimum(abs(a), 2 * abs(b)))
    return np.pad(np.where(a * b > 0, np.sign(a) * size, 0.0), [(1, 1) if k == axis else (0, 0) for k in (0, 1)])


def rotated(mesh, q):
    """Averages after a step around the centre, by Heun's method with limited slopes; nothing moves near the sides."""
    stream = -0.5 * np.minimum((mesh.x - 0.5) ** 2 + (mesh.y - 0.5) ** 2, 0.45**2)
    through = np.diff(stream, axis=1), -np.diff(stream, axis=0)  # what flows through the edges, along both axes

    def rate(q):
        change = np.zeros_like(q)
        for axis, flow in enumerate(through):
            half, end = 0.5 * slopes(q, axis), np.eye(2, dtype=int)[axis][:, None]
            before, after = np.pad(q + half, end * (1, 0)), np.pad(q - half, end * (0, 1))
            change -= np.diff(flow * np.where(flow > 0, before, after), axis=axis)
        return change / areas(mesh)

    out = sum(np.maximum(-np.delete(f, -1, k), 0) + np.maximum(np.delete(f, 0, k), 0) for k, f in enumerate(through))
    count = int(np.ceil(STEP * (out / areas(mesh)).max() / 0.4))
    for _ in range(count):
        once = q + STEP / count * rate(q)
        q = 0.5 * (q + once + STEP / count * rate(once))
    return q


def run(steps, n=33, *, adapts=True):
    """Mesh and averages at the start and after each step."""
    mesh = em.Mesh.uniform(em.Grid(n_xi=n, n_eta=n))
    u = em.NodalField(mesh=mesh, values=at_nodes(averages(mesh, disc(0.0))))
    monitor = em.Smoothed(monitor=em.Curvature(u=u), radius=0.66 / n)  # so far that the front stays in its small cells
    meshes = em.Sequence(em.Problem(monitor=monitor, grid=mesh.grid), mesh=mesh)
    for _ in range(4 * adapts):  # the first mesh is for the function itself, not for its values on the uniform one
        meshes.step(at_nodes(averages(meshes.mesh, disc(0.0))))
    mesh, q = meshes.mesh, averages(meshes.mesh, disc(0.0))
    yield mesh, q
    for _ in range(steps):
        if adapts:
            step = meshes.step(at_nodes(q), {"q": em.MeshValues(q, transfer="conservative", location="cells")})
            mesh, q = step.mesh, step.fields["q"]
        q = rotated(mesh, q)
        yield mesh, q


def l1_error(mesh, q, steps):
    """The L1 norm of the error of averages."""
    return em.integral(mesh, abs(q - averages(mesh, disc(steps * STEP))), "cells")


def main(output: Path) -> None:
    states, (*_, fixed) = list(run(STEPS)), run(STEPS, adapts=False)
    masses, ends = [em.integral(m, p, "cells") for m, p in states], [(p.min(), p.max() - 1) for _, p in states]
    errors = l1_error(*states[-1], STEPS), l1_error(*fixed, STEPS)
    print(f"L1 error {errors[0]:.2e}, on the uniform mesh {errors[1]:.2e}; mass changed by {np.ptp(masses):.1e}")
    print(f"least value {min(ends)[0]:.1e}, largest value 1 + {max(end for _, end in ends):.1e}")
    figure, (mesh, q) = Figure(figsize=(5.4, 5.4), layout="constrained"), states[-1]
    axes = figure.add_subplot(title=f"after {STEPS} steps", aspect="equal")
    axes.pcolormesh(mesh.x, mesh.y, q, cmap="Blues", vmin=0, vmax=1.3)
    axes.plot(mesh.x, mesh.y, mesh.x.T, mesh.y.T, color="black", linewidth=0.4)
    figure.savefig(output / "rotating-disc.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
