"""Our meshes compared with those of Mmg2d and Gmsh: vertices a second, and the error with equal numbers of vertices.

pip install mmgpy gmsh
python benchmarks/peers.py --points 65 129 --functions paper ring
"""

from __future__ import annotations

import argparse
import os

from equimesh_cli.report import THREAD_COUNTS


def main() -> None:
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))  # before the linear algebra is loaded
    from costs import peers

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[65], help="points a side, for all meshers")
    parser.add_argument("--functions", nargs="+", choices=peers.FUNCTIONS, default=list(peers.FUNCTIONS))
    options = parser.parse_args()
    for n in options.points:
        for line in peers.lines(peers.compare(n, options.functions)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
