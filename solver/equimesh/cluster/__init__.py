"""One mesh, or one Schwarz iteration, on the workers of a Dask cluster.

It needs ``pip install 'equimesh[dask]'``. ``import equimesh`` does not import it.
"""

from equimesh_coupling.libraries import library

library("distributed", install="pip install 'equimesh[dask]'")

from equimesh.cluster.blocks import solve_blocks  # noqa: E402 - after the check for Dask
from equimesh.cluster.connection import connect  # noqa: E402 - after the check for Dask
from equimesh.cluster.errors import ClusterError, NoSchedulerError, RunCancelledError, WorkersLostError  # noqa: E402
from equimesh.cluster.handle import Handle, PartsError  # noqa: E402
from equimesh.cluster.progress import Progress  # noqa: E402
from equimesh.cluster.run import PartsRun, RunOptions, run_parts  # noqa: E402
from equimesh.cluster.schwarz import SchwarzHandle  # noqa: E402
from equimesh.cluster.solving import solve  # noqa: E402

__all__ = [  # noqa: RUF022 - grouped by noun
    # One mesh in parts
    "solve",
    "solve_blocks",
    "Handle",
    "Progress",
    "SchwarzHandle",
    # One function on many workers
    "run_parts",
    "RunOptions",
    "PartsRun",
    "connect",
    # Errors, drawn as a tree in ``equimesh/cluster/errors.py``
    "ClusterError",
    "NoSchedulerError",
    "PartsError",
    "RunCancelledError",
    "WorkersLostError",
]
