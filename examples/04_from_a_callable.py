"""A mesh from a Python function, which the client samples in this process: any code may compute it.

pip install 'equimesh[service]'
python 04_from_a_callable.py [--url http://127.0.0.1:8000]
"""

import argparse
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from equimesh_client import Client


def clover(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """1 inside a leaf with three lobes, -1 outside, and a steep slope between; takes and returns whole arrays."""
    radius, angle = np.hypot(x - 0.5, y - 0.5), np.arctan2(x - 0.5, y - 0.5)
    return np.tanh(25 * (0.3 + 0.08 * np.cos(3 * angle) - radius))


def main(url: str | None, output: Path) -> None:
    with ExitStack() as stack:
        if url is None:
            from equimesh_service import Settings, running

            folder = stack.enter_context(TemporaryDirectory())
            url = stack.enter_context(running(Settings(port=0, workers=1, data_dir=folder, log_level="warning")))
        client = stack.enter_context(Client(url))

        mesh = client.generate(clover, 49, n_samples=129)  # called once, with arrays of 129 x 129 points

        print(mesh.quality)
        largest = abs(mesh.u - clover(mesh.x, mesh.y)).max()
        print(f"at the nodes, the service's spline of the samples differs by at most {largest:.1e}")
        mesh.plot(output / "clover.png")
        print(f"wrote {mesh.download(output / 'clover.xdmf')} and {output / 'clover.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--url", help="address of a service; without it one is started")
    parser.add_argument("--output", type=Path, default=Path("example-output"), help="folder for files")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    main(options.url, options.output)
