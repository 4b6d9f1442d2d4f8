"""Samples read from files that callers send."""

from equimesh.upload.samples import read_arrays, read_npz, read_samples, samples_of

__all__ = ["read_arrays", "read_npz", "read_samples", "samples_of"]
