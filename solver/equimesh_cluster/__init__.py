"""One mesh in parts: on the workers of a Dask cluster, and in files, one for each part.

The names of files need ``equimesh`` alone. The others need ``pip install 'equimesh[dask]'``, which is imported with the
first of them. ``import equimesh`` does not import this package.
"""

from typing import TYPE_CHECKING

from equimesh_coupling.errors import deferred, library

if TYPE_CHECKING:
    from equimesh_cluster.connection import connect
    from equimesh_cluster.errors import ClusterError, NoSchedulerError, RunCancelledError, WorkersLostError
    from equimesh_cluster.handle import Handle, PartsError
    from equimesh_cluster.mesh_part import MeshPart, cut
    from equimesh_cluster.part_files.formats import PARTED_FORMATS, PartData, PartedFormat
    from equimesh_cluster.part_files.parted_mesh import PartedMesh, read_parts, remove_parted, write_head, write_part
    from equimesh_cluster.run import PartsRun, RunOptions, run_parts
    from equimesh_cluster.schwarz import SchwarzHandle
    from equimesh_cluster.solving import Progress, solve, solve_blocks

__all__ = [  # noqa: RUF022 - grouped by noun
    # One mesh in parts
    "solve",
    "solve_blocks",
    "Handle",
    "Progress",
    "SchwarzHandle",
    # Parts and their files
    "MeshPart",
    "cut",
    "PARTED_FORMATS",
    "PartData",
    "PartedFormat",
    "PartedMesh",
    "read_parts",
    "remove_parted",
    "write_head",
    "write_part",
    # One function on many workers
    "run_parts",
    "RunOptions",
    "PartsRun",
    "connect",
    # Errors, drawn as a tree in ``equimesh_cluster/errors.py``
    "ClusterError",
    "NoSchedulerError",
    "PartsError",
    "RunCancelledError",
    "WorkersLostError",
]

_WITHOUT_DASK = __all__[__all__.index("MeshPart") : __all__.index("run_parts")]
"""The names that need no Dask."""

if not TYPE_CHECKING:

    def __getattr__(name):
        """A name of ``__all__``, whose module is imported at its first use."""
        if name in __all__ and name not in _WITHOUT_DASK:
            library("distributed", install="pip install 'equimesh[dask]'")
        return deferred(__name__, name)
