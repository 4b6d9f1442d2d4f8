"""The errors of a cluster: one tree, drawn here.

::

    EquimeshError
    └── ClusterError          a cluster does not run what it was given; the message says why, and what to do
        ├── NoSchedulerError  no scheduler answers, or the connection to it is lost
        ├── PartsError        a mesh in parts is not the requested one; it carries the handle of what there is, and is
        │                     defined in :mod:`equimesh_cluster.handle`
        ├── WorkersLostError  a worker was lost in each attempt, or none is left
        └── RunCancelledError the caller ended the run
"""

from __future__ import annotations

from equimesh.errors import EquimeshError


class ClusterError(EquimeshError):
    """A cluster that does not run what it was given: no scheduler, other versions, too little memory."""


class NoSchedulerError(ClusterError):
    """A scheduler that does not answer, or does not answer any more."""


class WorkersLostError(ClusterError):
    """A run that was given up since workers were lost. ``lost`` are their addresses, in the order of the loss."""

    def __init__(self, message: str, *, lost: tuple[str, ...]) -> None:
        super().__init__(message)
        self.lost = lost


class RunCancelledError(ClusterError):
    """A run that its caller ended."""
