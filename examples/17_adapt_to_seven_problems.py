"""Seven problems with layers, and what a mesh that adapts to the solver's own solution gains on each.

-eps Laplace(u) + b . grad(u) + c u = f by bilinear elements with SUPG, on 65 x 65 nodes. The loop knows nodal values
only. The gain is the error on the uniform mesh over that on the best mesh, in the L2 norm and the H1 seminorm.

    pip install 'equimesh[solver,plot]' scikit-fem
    python 17_adapt_to_seven_problems.py             # half a minute; --only A B takes some of them
"""

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import skfem
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from skfem.helpers import dot, grad

import equimesh as em

N, CENTRE = 65, np.array([[0.5], [0.5]])
LAYERS = "(1 - exp((x - 1)/0.001))*(1 - exp((y - 1)/0.001))"
SIDES = "(1 - exp(-{0}/0.005) - exp(({0} - 1)/0.005))"
PROBLEMS = {  # u, eps, b, c
    "A": ("tanh(60*(x + y/2 - 0.75))", 1e-3, (1.0, -2.0), 0.0),
    "A200": ("tanh(200*(x + y/2 - 0.75))", 1e-3, (1.0, -2.0), 0.0),
    "B": ("(x - exp((x - 1)/0.001))*(y - exp((y - 1)/0.001))", 1e-3, (1.0, 1.0), 0.0),
    "C": (f"(1 + tanh(60*(y - x/2 - 0.25)))/2*{LAYERS}", 1e-3, (1.0, 0.5), 0.0),
    "D": (f"{SIDES.format('x')}*{SIDES.format('y')}", 2.5e-5, (0.0, 0.0), 1.0),
    "E": ("tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", 1.0, (0.0, 0.0), 0.0),
    "A2": ("16*x*(1-x)*y*(1-y)*(0.5 + atan(200*(0.0625 - (x-0.5)**2 - (y-0.5)**2))/pi)", 1e-3, (2.0, 3.0), 2.0),
}


def supg_parameter(mesh, b, eps):
    """tau of every cell, shape (cells, 1): docs/how-to/supg.md says why the thickness of the cell has to bound it."""
    speed = np.hypot(*b)
    if speed == 0.0:
        return np.zeros((mesh.nelements, 1))
    basis = skfem.Basis(mesh, skfem.ElementQuad1(), quadrature=(CENTRE, np.ones(1)))
    length = 2 * speed / sum(abs(b[0] * shape[0].grad[0] + b[1] * shape[0].grad[1]) for shape in basis.basis)
    peclet = speed * length / (2 * eps)
    tau = length / (2 * speed) * (1 / np.tanh(peclet) - 1 / peclet)
    jacobians = basis.mapping.DF(CENTRE).transpose(2, 3, 0, 1)
    return np.minimum(tau, np.linalg.svd(jacobians, compute_uv=False)[..., -1] ** 2 / (12 * eps))


def solve(u, eps, b, c, mesh):
    """The solution at the nodes of a mesh."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=6)
    v, v_x, v_y, v_xx, _, v_yy = u.evaluate(*basis.global_coordinates(), order=2)
    source = -eps * (v_xx + v_yy) + b[0] * v_x + b[1] * v_y + c * v
    tau = supg_parameter(basis.mesh, b, eps) * np.ones_like(source)

    def along(v):
        return b[0] * grad(v)[0] + b[1] * grad(v)[1]

    form = skfem.BilinearForm(
        lambda v, w, at: eps * dot(grad(v), grad(w)) + (along(v) + c * v) * (w + at.tau * along(w))
    )
    load = skfem.LinearForm(lambda w, at: at.f * (w + at.tau * along(w)))
    system = form.assemble(basis, tau=tau), load.assemble(basis, f=source, tau=tau)
    sides = basis.get_dofs(["left", "right", "bottom", "top"])
    return skfem.solve(*skfem.condense(*system, x=u.evaluate(*basis.doflocs)[0], D=sides))


def errors(u, record):
    """The errors of a round in the L2 norm and the H1 seminorm."""
    basis = skfem.Basis(record.mesh.to_skfem(), skfem.ElementQuad1(), intorder=11)
    v, *slopes = u.evaluate(*basis.global_coordinates(), order=1)
    found = basis.interpolate(record.values.ravel())
    h1 = sum(((found.grad[k] - slopes[k]) ** 2 * basis.dx).sum() for k in (0, 1))
    return np.sqrt([((found - v) ** 2 * basis.dx).sum(), h1])


def main(only: list[str], output: Path) -> None:
    print("problem   gain L2   gain H1   best round   resolved   estimate over error")
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    for name, axes in zip(only, figure.subplots(2, 4).flat, strict=False):
        text, eps, b, c = PROBLEMS[name]
        u = em.Expression(text)
        result = em.adapt(partial(solve, u, eps, b, c), N)
        first, best = (errors(u, result.rounds[number]) for number in (0, result.best))
        l2, h1 = first / best
        print(
            f"{name:<7}{l2:>10.1f}{h1:>10.1f}{result.best:>13}{result.resolved!s:>11}{result.estimate / best[0]:>14.2f}"
        )
        nodes = np.stack([result.mesh.x, result.mesh.y], axis=-1)
        lines = [*nodes[::8], *nodes.swapaxes(0, 1)[::8]]  # every eighth
        axes.add_collection(LineCollection(lines, colors="0.2", linewidths=0.7))
        axes.set(title=f"{name}: {l2:.3g} in L2, {h1:.3g} in H1", aspect="equal", xticks=[], yticks=[])
        axes.axis((0, 1, 0, 1))
    for axes in figure.axes[len(only) :]:
        axes.axis("off")
    figure.savefig(output / "adapt-problems.png", dpi=80)
    print(f"wrote {output / 'adapt-problems.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PROBLEMS, default=[*PROBLEMS], help="some of the problems")
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.only, options.output)
