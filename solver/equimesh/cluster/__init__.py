"""One mesh, or one Schwarz iteration, on the workers of a Dask cluster.

It needs ``pip install 'equimesh[dask]'``. ``import equimesh`` does not import it.
"""

from equimesh_coupling.libraries import library

library("distributed", install="pip install 'equimesh[dask]'")

from equimesh.cluster.connection import connect  # noqa: E402 - after the check for Dask
from equimesh.cluster.errors import ClusterError, RunCancelledError, WorkersLostError  # noqa: E402
from equimesh.cluster.run import PartsRun, RunOptions, run_parts  # noqa: E402

__all__ = ["ClusterError", "PartsRun", "RunCancelledError", "RunOptions", "WorkersLostError", "connect", "run_parts"]
