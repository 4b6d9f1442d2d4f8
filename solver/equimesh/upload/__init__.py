"""Samples read from files that callers send."""

from typing import TYPE_CHECKING, Any

from equimesh_coupling.errors import deferred

if TYPE_CHECKING:
    from equimesh.upload.samples import read_arrays, read_npz, read_samples, samples_of

__all__ = ["read_arrays", "read_npz", "read_samples", "samples_of"]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        return deferred(__name__, name)
