"""From a function to a PDE solved on its mesh, in five minutes: service, client, scikit-fem.

-Laplace(v) = f on the unit square, with f and the boundary values of a wave front: v = arctan(60 (r - 0.7)), r the
distance from (-0.05, -0.05). The same elements on the adapted and on uniform meshes; v gives their errors.

    pip install 'equimesh[service]' scikit-fem
    python 02_poisson_on_the_mesh.py                               # starts its own service
    python 02_poisson_on_the_mesh.py --url http://127.0.0.1:8000   # uses a running one
"""

import argparse
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import skfem
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from skfem.helpers import dot, grad

from equimesh_client import Client, LeastError

N = 65
FRONT = "atan(60*(sqrt((x + 0.05)**2 + (y + 0.05)**2) - 0.7))"
LEAST = LeastError(u=FRONT, norm="h1")  # finite elements are as good as the interpolant, in the norm of the gradient


def front(x, y):
    """v, v_x, v_y and f = -(v_rr + v_r / r) of the wave front."""
    r = np.hypot(x + 0.05, y + 0.05)
    s = 60 * (r - 0.7)
    v_r, v_rr = 60 / (1 + s**2), -7200 * s / (1 + s**2) ** 2
    return np.arctan(s), v_r * (x + 0.05) / r, v_r * (y + 0.05) / r, -(v_rr + v_r / r)


def solve(mesh: skfem.MeshQuad):
    """The finite element solution at the nodes, and its errors in the L2 norm and the H1 seminorm."""
    basis = skfem.Basis(mesh, skfem.ElementQuad1(), intorder=8)
    matrix = skfem.BilinearForm(lambda v, w, _: dot(grad(v), grad(w))).assemble(basis)
    load = skfem.LinearForm(lambda w, at: front(*at.x)[3] * w).assemble(basis)
    fixed = basis.get_dofs(["left", "right", "bottom", "top"])  # the file names the sides
    v = skfem.solve(*skfem.condense(matrix, load, x=front(*basis.doflocs)[0], D=fixed))
    l2 = skfem.Functional(lambda at: (at["found"] - front(*at.x)[0]) ** 2)
    h1 = skfem.Functional(lambda at: sum((at["found"].grad[k] - front(*at.x)[1 + k]) ** 2 for k in (0, 1)))
    return v, *(float(np.sqrt(norm.assemble(basis, found=v))) for norm in (l2, h1))


def main(url: str | None, output: Path) -> None:
    with ExitStack() as stack:
        if url is None:
            from equimesh_service import Settings, running

            folder = stack.enter_context(TemporaryDirectory())
            url = stack.enter_context(running(Settings(port=0, workers=1, data_dir=folder, log_level="warning")))
        file = stack.enter_context(Client(url)).generate(n=N, monitor=LEAST).download(output / "poisson.msh")
    meshes = {"adapted": skfem.MeshQuad.load(file)}
    for name, n in (("uniform", N), ("uniform, finer", 2 * N - 1)):
        meshes[name] = skfem.MeshQuad.init_tensor(*[np.linspace(0, 1, n)] * 2).with_defaults()
    print("mesh              nodes   L2 error   H1 error")
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    for (name, mesh), axes in zip(meshes.items(), figure.subplots(1, 3), strict=True):
        v, l2, h1 = solve(mesh)
        print(f"{name:<16}{mesh.nvertices:>7}   {l2:.2e}   {h1:.2e}")
        error = np.abs(v - front(*mesh.p)[0]).clip(1e-9)
        image = axes.tripcolor(*mesh.p, mesh.to_meshtri().t.T, error, norm=LogNorm(1e-5, 1e-1), shading="gouraud")
        axes.set(title=f"{name}: {mesh.nvertices} nodes\nL2 error {l2:.1e}", aspect="equal")
        axes.axis((0, 1, 0, 1))
    figure.colorbar(image, ax=figure.axes, label="error at the nodes")
    figure.savefig(output / "poisson.png", dpi=120)
    print(f"wrote {file} and {output / 'poisson.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", help="address of a service; without it one is started")
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.url, options.output)
