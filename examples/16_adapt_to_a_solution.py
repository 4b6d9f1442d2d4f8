"""Solve, adapt, solve: a mesh for a solution that nobody knows, in process, with scikit-fem.

-eps Laplace(u) + b . grad(u) = f with a front that the stream crosses, and a layer on two sides that is a sixteenth of
a cell of the uniform mesh. `equimesh.adapt` only gets nodal values; the known u gives the errors that are printed.

    pip install 'equimesh[solver,plot]' scikit-fem
    python 16_adapt_to_a_solution.py
"""

import argparse
from pathlib import Path

import numpy as np
import skfem
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from skfem.helpers import dot, grad

import equimesh as em

N, EPS, B = 65, 1e-3, np.array([1.0, 0.5])
U = em.Expression("(1 + tanh(60*(y - x/2 - 0.25)))/2*(1 - exp((x - 1)/0.001))*(1 - exp((y - 1)/0.001))")
LEVELS = np.linspace(-0.1, 2.1, 12)  # of the colours
CENTRE = np.array([[0.5], [0.5]])


def supg_parameter(mesh: skfem.MeshQuad) -> np.ndarray:
    """tau of every cell, shape (cells, 1): docs/how-to/supg.md says why the thickness of the cell has to bound it."""
    basis = skfem.Basis(mesh, skfem.ElementQuad1(), quadrature=(CENTRE, np.ones(1)))
    speed = np.hypot(*B)
    length = 2 * speed / sum(abs(B[0] * shape[0].grad[0] + B[1] * shape[0].grad[1]) for shape in basis.basis)
    peclet = speed * length / (2 * EPS)
    tau = length / (2 * speed) * (1 / np.tanh(peclet) - 1 / peclet)
    jacobians = basis.mapping.DF(CENTRE).transpose(2, 3, 0, 1)
    thickness = np.linalg.svd(jacobians, compute_uv=False)[..., -1]
    return np.minimum(tau, thickness**2 / (12 * EPS))


def solve(mesh: em.Mesh) -> np.ndarray:
    """The solution at the nodes of the mesh: all that the loop gets to know."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=6)
    _, u_x, u_y, u_xx, _, u_yy = U.evaluate(*basis.global_coordinates(), order=2)
    source = -EPS * (u_xx + u_yy) + B[0] * u_x + B[1] * u_y
    tau = supg_parameter(basis.mesh) * np.ones_like(source)

    def along(v):
        return B[0] * grad(v)[0] + B[1] * grad(v)[1]

    @skfem.BilinearForm
    def form(u, v, at):
        return EPS * dot(grad(u), grad(v)) + along(u) * (v + at.tau * along(v))

    @skfem.LinearForm
    def load(v, at):
        return at.f * (v + at.tau * along(v))

    sides = basis.get_dofs(["left", "right", "bottom", "top"])
    system = form.assemble(basis, tau=tau), load.assemble(basis, f=source, tau=tau)
    return skfem.solve(*skfem.condense(*system, x=U.evaluate(*basis.doflocs)[0], D=sides))


def errors(mesh: em.Mesh, values: np.ndarray) -> tuple[float, float]:
    """The true errors in the L2 norm and the H1 seminorm."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=11)
    u, *slopes = U.evaluate(*basis.global_coordinates(), order=1)
    found = basis.interpolate(values.ravel())
    h1 = sum(((found.grad[k] - slopes[k]) ** 2 * basis.dx).sum() for k in (0, 1))
    return float(np.sqrt(((found - u) ** 2 * basis.dx).sum())), float(np.sqrt(h1))


def draw(result: em.Adaptation, path: Path) -> None:
    """Every fourth line of the first and of the best mesh, with u as colour."""
    figure = Figure(figsize=(10, 5.1), layout="constrained")
    rounds = (result.rounds[0], result.rounds[result.best])
    for axes, record in zip(figure.subplots(1, 2), rounds, strict=True):
        mesh, (l2, _) = record.mesh, errors(record.mesh, record.values)
        axes.contourf(mesh.x, mesh.y, record.values, levels=LEVELS, cmap="Blues")
        nodes = np.stack([mesh.x, mesh.y], axis=-1)
        lines = [*nodes[::4], *nodes.swapaxes(0, 1)[::4]]
        axes.add_collection(LineCollection(lines, colors="0.2", linewidths=0.5))
        axes.set(title=f"round {record.number}: L2 error {l2:.1e}", aspect="equal")
        axes.axis((0, 1, 0, 1))
    figure.savefig(path, dpi=100)


def main(output: Path) -> None:
    print("round   estimate   L2 error   H1 error   gain L2   gain H1   unresolved   mesh from")

    def observe(record: em.AdaptRound) -> None:
        found = errors(record.mesh, record.values)
        first.append(found)
        gains = [one / other for one, other in zip(first[0], found, strict=True)]
        print(
            f"{record.number:>5}   {record.estimate:8.2e}   {found[0]:8.2e}   {found[1]:8.2e}   {gains[0]:7.1f}"
            f"   {gains[1]:7.1f}   {record.unresolved:10.3f}   {record.start}"
        )

    first: list[tuple[float, float]] = []
    result = em.adapt(solve, N, observe=observe)
    print(f"best: round {result.best}; resolved: {result.resolved}. {result.reason}")
    draw(result, output / "adapt.png")
    print(f"wrote {output / 'adapt.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    folder: Path = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    main(folder)
