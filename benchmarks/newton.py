"""The sweeps compared with guarded Newton and sparse direct solvers, over the same nested grids to the same mesh.

CPU time of the finest level from one start, and of the whole solve. MKL PARDISO is included where pypardiso is
installed.

    python benchmarks/newton.py --points 65 129 257
"""

from __future__ import annotations

import argparse
import os

from equimesh_cli.report import THREAD_COUNTS


def main() -> None:
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))  # before the linear algebra is loaded
    from costs import newton, rows

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[65, 129, 257], help="points a side")
    for n in parser.parse_args().points:
        for line in rows.lines(newton.compare(n)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
