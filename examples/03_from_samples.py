"""A mesh from samples: the solution of a PDE on a coarse grid, sent to a service as an array.

Two drops merge by the Allen-Cahn equation w_t = Laplace(w) + (w - w^3) / eps^2. A few explicit steps on a uniform grid
give the samples. The mesh has its points at the interface, for the next, finer solve.

    pip install 'equimesh[service]'
    python 03_from_samples.py [--url http://127.0.0.1:8000]
"""

import argparse
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from equimesh_client import Client

N, EPS = 49, 0.03


def drops(steps: int) -> np.ndarray:
    """Values w[i, j] at (x_i, y_j) after explicit time steps: the first index runs along x."""
    x, y = np.meshgrid(np.linspace(0, 1, N), np.linspace(0, 1, N), indexing="ij")
    w = np.where(np.minimum(np.hypot(x - 0.33, y - 0.42), np.hypot(x - 0.66, y - 0.58)) < 0.2, 1.0, -1.0)
    h = 1 / (N - 1)
    for _ in range(steps):
        e = np.pad(w, 1, mode="edge")
        laplace = (e[2:, 1:-1] + e[:-2, 1:-1] + e[1:-1, 2:] + e[1:-1, :-2] - 4 * w) / h**2
        w = w + 0.2 * h**2 * (laplace + (w - w**3) / EPS**2)
    return w


def main(url: str | None, output: Path) -> None:
    with ExitStack() as stack:
        if url is None:
            from equimesh_service import Settings, running

            folder = stack.enter_context(TemporaryDirectory())
            url = stack.enter_context(running(Settings(port=0, workers=1, data_dir=folder, log_level="warning")))
        client = stack.enter_context(Client(url))

        w = drops(steps=60)
        mesh = client.generate(w, N)  # the array is the whole request

        interface = abs(mesh.u) < 0.9  # mesh.u: the spline of the samples at the new nodes
        print(f"nodes in the interface: {interface.sum()} on the mesh, {(abs(w) < 0.9).sum()} on the uniform grid")
        print(mesh.quality)
        mesh.plot(output / "drops.png")
        print(f"wrote {mesh.download(output / 'drops.vtu')} and {output / 'drops.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", help="address of a service; without it one is started")
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.url, options.output)
